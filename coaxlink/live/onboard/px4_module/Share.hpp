// Which share of the hover thrust the upper rotors give: the law's own, what COAX_SHARE says, or a trial in flight.
//
// A trial (COAX_SHARE_TRY) is flown from the moment it changes, and only while what commands the vehicle is alive:
// armed, in offboard mode, set-points fresh, every motor in the law. Once any of that ends, the share on board flies
// again, and the trial not until it changes anew: whoever set it may be dead, and the number stays in the parameters.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace coaxlink
{

template<int COUNT> class Share
{
public:
	Share(const float (&share)[COUNT], const float (&lean)[COUNT], float own) : _shares(share), _leans(lean), _own(own) {}

	// The parameters as they are when the module starts: a trial that is left in them is not flown. Returns as `take`.
	bool begin(float on_board, float trial)
	{
		_trial_seen = trial;
		const bool refused = take(on_board, trial);
		flown = _on_board;
		return refused;
	}

	// The parameters. Returns whether one has become what is no share that these rotors have, and so is not flown.
	bool take(float on_board, float trial)
	{
		const bool asked = differs(on_board, 0.f), tries = differs(trial, 0.f);
		const bool changed = differs(on_board, _on_board_seen), tried_anew = differs(trial, _trial_seen);
		_on_board_seen = on_board;
		_trial_seen = trial;
		_on_board = asked && has(on_board) ? on_board : _own;

		if (tried_anew) { _trial = tries && has(trial) ? trial : 0.f; }

		return (changed && asked && !has(on_board)) || (tried_anew && tries && !has(trial));
	}

	// Moves what is flown by `dt` s; `alive` as above. Returns the law's lean.
	float lean(float dt, bool alive)
	{
		if (!alive) { _trial = 0.f; }

		const bool trying = _trial > 0.f;
		_back = (_back || _tried) && !trying;
		_tried = trying;
		const float wanted = trying ? _trial : _on_board, step = (_back ? BACK_1_S : MOVE_1_S) * dt;
		flown = std::fabs(wanted - flown) <= step ? wanted : (wanted > flown ? flown + step : flown - step);
		_back = _back && differs(flown, wanted);
		return between(flown);
	}

	bool tried() const { return _tried; }
	float least() const { return _shares[0]; }
	float most() const { return _shares[COUNT - 1]; }

	float flown = 0.f;  // in hover

	static constexpr float MOVE_1_S = 0.05f, BACK_1_S = 1.f;  // of the share a second: a step of a plan; an end of it

private:
	bool has(float share) const { return COUNT > 1 && share >= least() && share <= most(); }  // not NaN

	static bool differs(float a, float b) { return std::memcmp(&a, &b, sizeof(a)) != 0; }

	float between(float share) const
	{
		for (int n = 1; n < COUNT; n++) {
			if (share <= _shares[n]) {
				const float part = (share - _shares[n - 1]) / (_shares[n] - _shares[n - 1]);
				return _leans[n - 1] + (part > 0.f ? part : 0.f) * (_leans[n] - _leans[n - 1]);
			}
		}

		return _leans[COUNT - 1];
	}

	const float (&_shares)[COUNT];
	const float (&_leans)[COUNT];
	const float _own;
	float _on_board = 0.f, _trial = 0.f, _on_board_seen = 0.f, _trial_seen = 0.f;
	bool _tried = false, _back = false;
};

}  // namespace coaxlink
