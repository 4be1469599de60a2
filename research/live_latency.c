/* The floor of live_latency.py: a UDP echo, and the client that paces demands and times the answers.
 *
 *   live_latency echo PORT
 *   live_latency client FD RATE_HZ COUNT WARM_UP   (FD: a connected UDP socket; round trips, ns, on stdout,
 *                                                   -1 after 20 ms; last the answers that came later)
 *   live_latency flood FD RATE_HZ                  (datagrams from stdin, each after its length in 2 bytes,
 *                                                   over and over until SIGTERM; then how many a second)
 */
#include <arpa/inet.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define DEMAND 140
#define ANSWER 139
#define DEMAND_SEED 181

static uint64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000ull + (uint64_t)t.tv_nsec;
}

static uint16_t crc(const uint8_t *data, int size, uint16_t sum) {
    for (int i = 0; i < size; i++) {
        uint8_t x = data[i] ^ (uint8_t)(sum & 0xff);
        x ^= (uint8_t)(x << 4);
        sum = (uint16_t)((sum >> 8) ^ (x << 8) ^ (x << 3) ^ (x >> 4));
    }
    return sum;
}

static int demand(uint8_t *out, uint8_t sequence, uint64_t stamp) {
    float controls[8] = {0.01f, -0.01f, 0.02f, 0.3f, 0.0f, 0.0f, 0.0f, 0.0f};
    controls[0] = 0.02f * (float)((int)(stamp / 1000 % 100) - 50) / 50.0f;
    int size = 8 + 16; /* the zeros behind are cut */
    uint8_t head[10] = {0xFD, (uint8_t)size, 0, 0, sequence, 1, 1, DEMAND, 0, 0};
    memcpy(out, head, 10);
    memcpy(out + 10, &stamp, 8);
    memcpy(out + 18, controls, 16);
    uint16_t sum = crc(out + 1, 9 + size, 0xffff);
    uint8_t seed = DEMAND_SEED;
    sum = crc(&seed, 1, sum);
    memcpy(out + 10 + size, &sum, 2);
    return 12 + size;
}

static int echo(int port) {
    int s = socket(AF_INET, SOCK_DGRAM, 0);
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(s, (struct sockaddr *)&a, sizeof a)) return 1;
    uint8_t in[2048], out[64] = {0xFD, 43};
    for (;;) {
        struct sockaddr_in from;
        socklen_t size = sizeof from;
        ssize_t n = recvfrom(s, in, sizeof in, 0, (struct sockaddr *)&from, &size);
        if (n < 18) continue;
        out[7] = ANSWER;
        memcpy(out + 10, in + 10, 8);
        sendto(s, out, 55, 0, (struct sockaddr *)&from, size);
    }
}

static int client(int fd, double rate, long count, long warm) {
    uint64_t period = (uint64_t)(1e9 / rate), next = now_ns() + period;
    uint8_t out[64], in[2048];
    int64_t late = 0;
    uint64_t overdue[64] = {0}; /* stamps not answered in time, the newest */
    for (long k = 0; k < warm + count; k++, next += period) {
        struct timespec t = {(time_t)(next / 1000000000ull), (long)(next % 1000000000ull)};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        uint64_t sent = now_ns(), stamp = sent / 1000;
        int size = demand(out, (uint8_t)k, stamp);
        if (send(fd, out, (size_t)size, 0) != size) return 1;
        int64_t took = -1;
        while (took < 0) {
            int64_t left = (int64_t)(sent + 20000000ull) - (int64_t)now_ns();
            struct pollfd p = {fd, POLLIN, 0};
            if (left <= 0 || poll(&p, 1, (int)(left / 1000000) + 1) <= 0) break;
            ssize_t n = recv(fd, in, sizeof in, 0);
            if (n < 18 || in[0] != 0xFD || in[7] != ANSWER) continue;
            if (!memcmp(in + 10, &stamp, 8))
                took = (int64_t)(now_ns() - sent);
            else {
                uint64_t whose;
                memcpy(&whose, in + 10, 8);
                for (int i = 0; i < 64; i++)
                    if (overdue[i] == whose && whose) late++, overdue[i] = 0;
            }
        }
        if (k >= warm && took < 0) overdue[k % 64] = stamp;
        if (k >= warm) fwrite(&took, sizeof took, 1, stdout);
        if (now_ns() > next + 4 * period) next = now_ns();
    }
    fwrite(&late, sizeof late, 1, stdout);
    return 0;
}

static volatile sig_atomic_t stopped;

static void stop(int number) {
    (void)number;
    stopped = 1;
}

static int flood(int fd, double rate) {
    static uint8_t all[1 << 20];
    size_t size = fread(all, 1, sizeof all, stdin), at = 0;
    uint64_t begin = now_ns();
    long sent = 0;
    double past = 0.0;
    signal(SIGTERM, stop);
    while (!stopped) {
        past = (double)(now_ns() - begin) / 1e9;
        for (long due = (long)(past * rate); sent < due && !stopped; sent++) {
            if (at + 2 > size) at = 0;
            size_t n = all[at] | (size_t)all[at + 1] << 8;
            send(fd, all + at + 2, n, 0);
            at += 2 + n;
        }
        struct timespec t = {0, 500000};
        nanosleep(&t, NULL);
    }
    printf("%.0f\n", (double)sent / past);
    return 0;
}

int main(int argc, char **argv) {
    if (argc == 3 && !strcmp(argv[1], "echo")) return echo(atoi(argv[2]));
    if (argc == 6 && !strcmp(argv[1], "client"))
        return client(atoi(argv[2]), atof(argv[3]), atol(argv[4]), atol(argv[5]));
    if (argc == 4 && !strcmp(argv[1], "flood")) return flood(atoi(argv[2]), atof(argv[3]));
    return 2;
}
