// The law of coax_vehicle.hpp on this machine: failed slots, budget and lean as arguments, four doubles a demand on stdin.
#include "coax_vehicle.hpp"
#include <chrono>
#include <cstdio>
#include <cstdlib>

int main(int argc, char **argv)
{
	using namespace coaxlink;

	if (argc != 4) { return 1; }

	static BoardLaw law(NUMBERS<float>, NUMBERS<double>, std::atoi(argv[2]));
	law.lean(static_cast<float>(std::atof(argv[3])));
	law.without(static_cast<uint32_t>(std::atoi(argv[1])));
	double demand[4], out[4 * ARMS + 5];

	while (std::fread(demand, sizeof(demand), 1, stdin) == 1) {
		float single[4];

		for (int j = 0; j < 4; j++) { single[j] = static_cast<float>(demand[j]); }

		const auto begun = std::chrono::steady_clock::now();
		law.solve(single);
		const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - begun;
		int n = 0;

		for (float u : law.speed) { out[n++] = static_cast<double>(u); }

		for (int slot = 0; slot < 2 * ARMS; slot++) { out[n++] = static_cast<double>(command(law.speed, slot)); }

		out[n++] = law.settled;
		out[n++] = law.fell_back;
		out[n++] = law.work;
		out[n++] = took.count();
		out[n++] = law.looks;
		std::fwrite(out, sizeof(out), 1, stdout);
	}
}
