#include "Share.hpp"
#include <cstdio>

// a word a line: `b own trial` the module starts; `p own trial` its parameters; `r seconds alive` it runs so long at
// 250 Hz and says share flown, lean, whether on trial, and what was refused so far
int main()
{
	static const float share[5] = {0.3f, 0.35f, 0.4f, 0.45f, 0.5f}, lean[5] = {0.3f, 0.1f, 0.f, -0.1f, -0.3f};
	coaxlink::Share<5> s(share, lean, 0.4f);
	char word;
	float a, b;
	int refused = 0;

	while (std::scanf(" %c %f %f", &word, &a, &b) == 3) {
		if (word == 'b') { refused += s.begin(a, b); }

		if (word == 'p') { refused += s.take(a, b); }

		if (word == 'r') {
			float by = s.lean(0.f, b > 0.f);

			for (int n = 0; n < static_cast<int>(a * 250.f + 0.5f); n++) { by = s.lean(0.004f, b > 0.f); }

			std::printf("%.4f %.4f %d %d\n", static_cast<double>(s.flown), static_cast<double>(by), s.tried(), refused);
		}
	}

	return 0;
}
