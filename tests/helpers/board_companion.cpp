#include "Companion.hpp"
#include <cstdio>

// a word a line: `d now` a demand goes out; `a now identity token number system component rotors speed` an answer comes;
// `s now` its first rotor is taken out of the law; `b now` a blend: what a rotor that flies 0.5 by the own law flies, and what was refused so far
int main()
{
	static coaxlink::Companion<2> c(0xabcdef);
	char word;
	unsigned long long now;

	while (std::scanf(" %c %llu", &word, &now) == 2) {
		const float delivered[4] = {0.f, 0.f, 0.5f, 0.f};

		if (word == 'd') { c.sent(now, delivered); }

		if (word == 's') { c.stopped = 1; }

		if (word == 'a') {
			unsigned identity, token, number, system, component, rotors;
			float u;

			if (std::scanf("%x %u %u %u %u %u %f", &identity, &token, &number, &system, &component, &rotors, &u) != 7) { return 1; }

			uint8_t payload[128] {};
			const float speed[2] = {u, u};
			std::memcpy(payload, &identity, 4);
			std::memcpy(payload + 4, &token, 4);
			std::memcpy(payload + 8, &number, 4);
			payload[12] = static_cast<uint8_t>(system);
			payload[13] = static_cast<uint8_t>(component);
			payload[14] = static_cast<uint8_t>(rotors);
			payload[15] = coaxlink::PROTOCOL;
			std::memcpy(payload + 16, speed, sizeof(speed));
			c.hear(now, payload, 24, true, [](const float *s, float *out) { out[0] = out[1] = out[3] = 0.f; out[2] = s[0]; });
		}

		if (word == 'b') {
			float speed[2] = {0.5f, 0.5f};
			c.blend(now, 0.004f, true, speed);
			std::printf("%.4f", static_cast<double>(speed[0]));

			for (uint32_t refused : c.refused) { std::printf(" %u", refused); }

			std::printf(" %u\n", c.handed_back);
		}
	}

	return 0;
}
