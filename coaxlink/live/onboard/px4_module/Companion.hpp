// Whose motor commands are flown, and for how long: one companion, while its answers are whole, fresh and plausible.
//
// An answer names the demand it answers; its age is that of the demand, by the vehicle's own clock. It is flown
// until the demand is older than `longest_us`. A companion that is killed, stopped, delayed, or sends another's or a
// broken answer is thereby out within that time, and the own law, which was solved all along, is what remains.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace coaxlink
{

constexpr uint16_t PAYLOAD_TYPE = 40001;  // of TUNNEL: above 32767, not registered
constexpr uint8_t PROTOCOL = 1;
constexpr uint32_t WHOLE = 1U << 24;      // whole numbers below are exact in a float

template<int ROTORS> class Companion
{
public:
	enum Refusal { FOREIGN, RIVAL, INVALID, STALE, IMPLAUSIBLE, REFUSALS };
	static constexpr int HEADER = 16, LENGTH = HEADER + 4 * ROTORS;

	explicit Companion(uint32_t identity) : _identity(identity) {}

	// A demand goes out: its number, and what the own law delivers of it (by rank, of the vehicle's authority).
	uint32_t sent(uint64_t now, const float delivered[4])
	{
		_sequence = (_sequence + 1) % WHOLE;
		Demand &d = _demands[_sequence % KEPT];
		d.sequence = _sequence;
		d.at = now;
		std::memcpy(d.delivered, delivered, sizeof(d.delivered));
		return _sequence;
	}

	// One answer. `deliver(speeds, out)` says what speeds would deliver, by rank.
	template<typename Deliver> void hear(uint64_t now, const uint8_t *payload, int length, bool for_us, Deliver deliver)
	{
		uint32_t identity, token, sequence;
		float speed[ROTORS];

		if (!for_us || length < LENGTH || payload[14] != ROTORS || payload[15] != PROTOCOL) { refuse(FOREIGN); return; }

		std::memcpy(&identity, payload, 4);
		std::memcpy(&token, payload + 4, 4);
		std::memcpy(&sequence, payload + 8, 4);
		std::memcpy(speed, payload + HEADER, sizeof(speed));

		if (identity != _identity) { refuse(FOREIGN); return; }

		const Who who{token, payload[12], payload[13]};

		if (followed(now) && !(who == _who)) { refuse(RIVAL); return; }

		for (float u : speed) { if (!(u >= 0.f && u <= 1.f)) { refuse(INVALID); return; } }  // also for NaN

		const Demand &demand = _demands[sequence % KEPT];
		const bool newer = !followed(now) || ahead(sequence, _answered);

		if (demand.at == 0 || demand.sequence != sequence || now - demand.at > longest_us || !newer) { refuse(STALE); return; }

		for (int i = 0; i < ROTORS; i++) { if (((stopped >> i) & 1U) && speed[i] > 0.f) { refuse(IMPLAUSIBLE); return; } }

		float delivered[4];
		deliver(speed, delivered);

		for (int j = 0; j < 4; j++) {
			if (!(std::fabs(delivered[j] - demand.delivered[j]) <= PLAUSIBLE)) { refuse(IMPLAUSIBLE); return; }
		}

		std::memcpy(_speed, speed, sizeof(_speed));
		_who = who;
		_answered = sequence;
		_of = demand.at;
		_heard = now;
		taken = (taken + 1) % 65536;
		const uint32_t age = static_cast<uint32_t>(now - demand.at);
		oldest_us = age > oldest_us ? age : oldest_us;
	}

	// Blend the companion's speeds into the own ones while they are fresh and wanted; `dt` s since the last call.
	void blend(uint64_t now, float dt, bool wanted, float speed[ROTORS])
	{
		if (!wanted || _heard == 0 || now - _of > longest_us) {
			handed_back += share > 0.f ? 1 : 0;
			share = 0.f;
			return;
		}

		share += dt / FADE_S;
		share = share < 1.f ? share : 1.f;

		for (int i = 0; i < ROTORS; i++) { speed[i] += share * (_speed[i] - speed[i]); }
	}

	bool followed(uint64_t now) const { return _heard != 0 && now - _heard <= FOLLOWED_US; }
	uint8_t system(uint64_t now) const { return followed(now) ? _who.system : 0; }
	uint8_t component(uint64_t now) const { return followed(now) ? _who.component : 0; }
	uint32_t token(uint64_t now) const { return followed(now) ? _who.token : 0; }

	uint32_t longest_us = 20000;     // COAX_TIMEOUT
	uint32_t stopped = 0;            // rotors out of the law (bit i): an answer that turns one does not know of it
	uint32_t refused[REFUSALS] {};
	uint32_t taken = 0, handed_back = 0, oldest_us = 0;
	float share = 0.f;               // of the companion in what is flown

private:
	static constexpr uint32_t KEPT = 64;
	static constexpr uint64_t FOLLOWED_US = 100000;  // of silence: then another may be followed
	static constexpr float FADE_S = 0.3f;            // from the own law to the companion's
	// Of the vehicle's authority: further from what the own law delivers no compensation of a battery, of air or of a
	// weak rotor takes a companion (speeds 10 % higher deliver 20 % more; at twice the weight of hover, 0.1).
	static constexpr float PLAUSIBLE = 0.15f;

	struct Demand { uint64_t at; uint32_t sequence; float delivered[4]; };
	struct Who {
		uint32_t token;
		uint8_t system, component;
		bool operator==(const Who &o) const { return token == o.token && system == o.system && component == o.component; }
	};

	static bool ahead(uint32_t a, uint32_t b) { return a != b && (a - b + WHOLE) % WHOLE < WHOLE / 2; }
	void refuse(Refusal why) { refused[why]++; }

	const uint32_t _identity;
	Demand _demands[KEPT] {};
	Who _who{};
	float _speed[ROTORS] {};
	uint32_t _sequence = 0, _answered = 0;
	uint64_t _of = 0, _heard = 0;
};

}  // namespace coaxlink
