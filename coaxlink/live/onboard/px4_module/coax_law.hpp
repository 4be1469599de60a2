// The exact law of coaxlink (mixer/exact/solver.py) for a flight controller: the same algorithm, line by line.
//
//     min sum torque_i speed_i   subject to   W(x) = demand,   lo <= x <= hi
//
// x are two coordinates an arm (mixer/exact/arms.py): the upper speed, and where the lower one lies between the least
// and the greatest that it may have beneath it. What an arm does are as few surfaces of these as its loads need.
// Axes are given up in order of priority (roll, pitch, thrust, yaw: yaw first). C++14, header only; no heap, no
// exceptions; every loop is bounded, and all of them together by `budget`. What does not settle within it goes on
// from there in the next call; meanwhile the better of it and the reduced mixer flies. What misses is looked for all
// round once: from hover, from the reduced mixer's answer, from both bounds. Motors are told what turns the speeds
// (`Drive`).
//
// While nothing but yaw is given up single precision solves it (`ExactLaw::solve`). A demand far out of reach has prices of a
// million full powers beside the power itself, more digits than single precision has: there, and after a jump, the
// same code runs in double precision, for which the flight controllers with STM32F76x and H7 have hardware.
#pragma once

#include <cmath>
#include <cstdint>

namespace coaxlink
{

// Levels below which a number is rounding, by precision. In single precision the wrench of eight rotors is known to
// some 1e-6 of the vehicle's authority, and no test may ask for more.
template<typename Real> struct Levels {
	static constexpr bool SINGLE = sizeof(Real) == sizeof(float);
	static constexpr Real BOUND = SINGLE ? Real(1e-6) : Real(1e-12);   // of full speed: at a bound
	static constexpr Real PUSH = SINGLE ? Real(2e-6) : Real(1e-12);    // of the slopes it is the sum of
	static constexpr Real TINY = SINGLE ? Real(1e-5) : Real(1e-9);     // pivot: the free rotors cannot move the axis
	static constexpr Real SETTLED_TINY = SINGLE ? Real(1e-6) : Real(1e-16);
	static constexpr Real NO_PIVOT = SINGLE ? Real(1e-12) : Real(1e-14);
	static constexpr Real RIDGE = SINGLE ? Real(1e-7) : Real(1e-9);
	static constexpr Real MISS = SINGLE ? Real(2e-6) : Real(1e-9);     // of the vehicle's authority
	static constexpr Real DUAL = SINGLE ? Real(1e-6) : Real(1e-12);
	static constexpr Real GIVEN_UP_DONE = SINGLE ? Real(2e-5) : Real(1e-6);
	static constexpr Real GAIN = SINGLE ? Real(1e-6) : Real(1e-11);    // of merit: no step is worth less
	static constexpr Real STEP = SINGLE ? Real(1e-6) : Real(1e-10);
};

// A vehicle of K arms; a single rotor is an arm whose second coordinate is held at 0. Axes in order of priority and in
// units of the vehicle's authority, power in units of full power (`coaxlink.mixer.exact.arms.scaled`).
template<typename Real, int K, int M, int NU, int NL, int PU, int PL> struct Vehicle {
	Real surface[K][M][(NU + 1) * (NL + 1)];
	Real power[K][(PU + 1) * (PL + 1)];
	Real lean[K][(PU + 1) * (PL + 1)];     // half of what the upper rotor lifts more, of the full thrust
	Real gain[K][M][4];                    // wrench by axis of a unit of each surface
	Real lo[2 * K];
	Real hi[2 * K];
	Real cap[4];                           // most that an axis is worth, in power
	Real reduced[2 * K][4];                // squared speeds of the reduced mixer, per unit of demand
	Real line[K][4];                       // least and greatest lower speed: at rest, and per unit of upper speed
	Real home[2 * K];                      // where the vehicle hovers
	Real within;                           // what is missed without being a fault
	// of an arm one of whose rotors stands still: where the lower one may lie beneath a still upper one, and the arm's
	// surfaces and power above a still lower one, by powers of the upper speed
	Real place[K][2];
	Real still_surface[K][M][NU + 1];
	Real still_power[K][PU + 1];
};

// What a motor is told for a speed (rotor/drive.py): command = c_0 + c_1 u + ... + (r + s u) Q, Q a polynomial of both
// speeds of its pair; below the least speed that was measured, straight to rest.
template<typename Real, int TU, int TL> struct Drive {
	Real torque[(TU + 1) * (TL + 1)];  // N m, by powers of the upper speed
	Real command[6];
	Real per_torque[2];
	Real least;

	Real at(Real upper, Real lower, bool is_lower) const
	{
		const Real u = is_lower ? lower : upper, held = u > least ? u : least;
		Real q = 0, c = 0;

		for (int a = TU; a >= 0; a--) {
			Real r = 0;

			for (int b = TL; b >= 0; b--) { r = r * lower + torque[a * (TL + 1) + b]; }

			q = q * upper + r;
		}

		for (int n = 5; n >= 0; n--) { c = c * held + command[n]; }

		c += (per_torque[0] + per_torque[1] * u) * q;
		return u < least ? c * u / least : c;
	}
};

// Where a law stands between two calls; the same in both precisions.
template<typename Real, int K> struct State {
	static constexpr int N = 2 * K;
	Real x[N] {};
	Real price[4] {};
	int gone[4] {};
	int act[N] {};
	Real smooth = 0;
	// remembered: the last call; the solutions before the last jump out of reach, and before that back
	Real mu[3][4] {};
	Real old_price[3][4] {};
	int old_gone[3][4] {};
	Real old_x[3][N] {};
	int old_act[3][N] {};

	template<typename Other> void adopt(const State<Other, K> &other)
	{
		for (int i = 0; i < N; i++) { x[i] = static_cast<Real>(other.x[i]); act[i] = other.act[i]; }

		for (int j = 0; j < 4; j++) { price[j] = static_cast<Real>(other.price[j]); gone[j] = other.gone[j]; }

		smooth = static_cast<Real>(other.smooth);

		for (int m = 0; m < 3; m++) {
			for (int j = 0; j < 4; j++) {
				mu[m][j] = static_cast<Real>(other.mu[m][j]);
				old_price[m][j] = static_cast<Real>(other.old_price[m][j]);
				old_gone[m][j] = other.old_gone[m][j];
			}

			for (int i = 0; i < N; i++) {
				old_x[m][i] = static_cast<Real>(other.old_x[m][i]);
				old_act[m][i] = other.old_act[m][i];
			}
		}
	}
};

template<typename Real, int K, int M, int NU, int NL, int PU, int PL> class Law
{
public:
	using Numbers = Vehicle<Real, K, M, NU, NL, PU, PL>;
	static constexpr int N = 2 * K;

	explicit Law(const Numbers &vehicle, int32_t budget = 400) : _budget(budget), _vehicle(vehicle) { lean(0); without(0); }

	// What is least: power, and so much times what upper rotors lift more (mixer/shares.py).
	void lean(Real by)
	{
		for (int k = 0; k < K; k++) {
			for (int i = 0; i < (PU + 1) * (PL + 1); i++) { _cost[k][i] = _vehicle.power[k][i] + by * _vehicle.lean[k][i]; }
		}
	}

	// Forget the last solution; slots of `failed` (bit i: speed i) stand still from now on.
	void without(uint32_t failed)
	{
		for (int i = 0; i < N; i++) {
			const bool off = (failed >> i) & 1U, beneath = i % 2 && ((failed >> (i - 1)) & 1U);
			_still[i] = off;
			_lo[i] = off ? Real(0) : (beneath ? _vehicle.place[i / 2][0] : _vehicle.lo[i]);
			_hi[i] = off ? Real(0) : (beneath ? _vehicle.place[i / 2][1] : _vehicle.hi[i]);
			state.old_x[LAST][i] = Real(0);
		}

		for (int j = 0; j < 4; j++) { state.mu[LAST][j] = state.mu[WITHIN][j] = state.mu[BEYOND][j] = NEVER; }

		state.smooth = 0;
		_stage = CLOSE;
		_looked_at = NEVER;
		stand(_vehicle.home);
	}

	// The best speeds for a demand (4) by rank; returns whether they are settled. Always within the bounds.
	bool solve(const Real demand[4])
	{
		Real last[N];

		for (int i = 0; i < N; i++) { last[i] = _answer[i]; }

		begin(demand);
		settled = optimum();
		finish();

		if (!settled) {
			prefer(last);
			prefer(_best);
		}

		fell_back = prefer_reduced();
		return settled;
	}

	// The same where a few steps from the last solution settle it and at most yaw is given up; else false.
	bool solve_near(const Real demand[4])
	{
		begin(demand);
		settled = settle(false) && !state.gone[0] && !state.gone[1] && !state.gone[2];
		settled = settled && ((!faulty() && state.smooth >= Real(0) && !stands()) || known());
		finish();
		return settled;
	}

	bool given_up() const { return state.gone[0] || state.gone[1] || state.gone[2] || state.gone[3]; }

	// What speeds deliver, by rank.
	void deliver(const Real speeds[], Real out[4]) const
	{
		Real at[N], left[4], power;
		placed(speeds, at);
		missing(at, left, power);

		for (int j = 0; j < 4; j++) { out[j] = mu[j] - left[j]; }
	}

	State<Real, K> state;
	Real speed[N] {};      // the answer
	Real mu[4] {};         // the demand, held to what is sane
	Real miss[4] {};       // demanded minus delivered by `speed`
	int32_t work = 0;      // passes over the arms that the last call took
	int32_t steps = 0;     // quadratic steps
	bool settled = false;
	bool fell_back = false;  // to the reduced mixer
	int32_t looks = 0;       // all round, since start

private:
	// levels of the algorithm; the same as in solver.py
	static constexpr Real CURVATURE = Real(0.05), STEP_DONE = Real(2e-3), SETTLING = Real(0.1), MOST_DEMAND = Real(4);
	static constexpr Real JUMP = Real(0.02), LEAP = Real(0.1), CLEARLY = Real(1.5), NEVER = Real(1e9);
	static constexpr int ROUNDS = 6, CLIMBS = 30, CUTS = 40, CORRECTIONS = 3, GRACE = 3, PERSIST = 60, STEPS = 6, STARTS = 4;
	enum { LAST = 0, WITHIN = 1, BEYOND = 2 };  // what is remembered
	enum { CLOSE, MIDDLE, SURE, LAST_STEPS };    // of `optimum`
	using L = Levels<Real>;

	static Real clip(Real v, Real lo, Real hi) { return v < lo ? lo : (v > hi ? hi : v); }
	static Real magnitude(Real v) { return v < Real(0) ? -v : v; }
	static Real larger(Real a, Real b) { return a > b ? a : b; }
	static Real sign(int s) { return static_cast<Real>(s); }
	bool spent() const { return work >= _budget; }

	void begin(const Real demand[4])
	{
		for (int j = 0; j < 4; j++) { mu[j] = clip(demand[j], -MOST_DEMAND, MOST_DEMAND); }

		work = steps = 0;
		fell_back = false;
		start();
	}

	void finish()
	{
		fresh_miss();

		answer(state.x);
	}

	void answer(const Real *x)
	{
		for (int k = 0; k < K; k++) {
			const Real u = x[2 * k], s = x[2 * k + 1], low = least(k, u);
			_answer[2 * k] = u;
			_answer[2 * k + 1] = s;
			speed[2 * k] = u;
			speed[2 * k + 1] = _hi[2 * k + 1] > _lo[2 * k + 1] ? low + (most(k, u) - low) * s : Real(0);
		}
	}

	Real least(int k, Real u) const { return _vehicle.line[k][0] + _vehicle.line[k][1] * u; }
	Real most(int k, Real u) const { return _vehicle.line[k][2] + _vehicle.line[k][3] * u; }

	// coordinates of speeds
	void placed(const Real *speeds, Real *at) const
	{
		for (int k = 0; k < K; k++) {
			const Real u = speeds[2 * k], low = least(k, u), span = most(k, u) - low;
			at[2 * k] = u;
			at[2 * k + 1] = span > Real(0) ? (speeds[2 * k + 1] - low) / span : Real(0);
		}
	}

	// surfaces and slopes; orders A, B

	template<int A, int B> static void surface(const Real *c, Real u, Real l, Real out[6])
	{
		Real f = 0, fu = 0, fuu = 0, fl = 0, ful = 0, fll = 0;

		for (int a = A; a >= 0; a--) {
			Real r = 0, rl = 0, rll = 0;

			for (int b = B; b >= 0; b--) {
				rll = rll * l + rl;
				rl = rl * l + r;
				r = r * l + c[a * (B + 1) + b];
			}

			fuu = fuu * u + fu;
			fu = fu * u + f;
			f = f * u + r;
			ful = ful * u + fl;
			fl = fl * u + rl;
			fll = fll * u + rll;
		}

		out[0] = f; out[1] = fu; out[2] = fl; out[3] = Real(2) * fuu; out[4] = ful; out[5] = Real(2) * fll;
	}

	template<int A, int B> static Real value(const Real *c, Real u, Real l)
	{
		Real f = 0;

		for (int a = A; a >= 0; a--) {
			Real r = 0;

			for (int b = B; b >= 0; b--) { r = r * l + c[a * (B + 1) + b]; }

			f = f * u + r;
		}

		return f;
	}

	void missing(const Real *at, Real *left, Real &power) const
	{
		for (int j = 0; j < 4; j++) { left[j] = mu[j]; }

		power = 0;

		for (int k = 0; k < K; k++) {
			const Real u = at[2 * k], l = at[2 * k + 1];

			for (int n = 0; n < M; n++) {
				const Real f = _still[2 * k + 1] ? value<NU, 0>(_vehicle.still_surface[k][n], u, 0)
					       : value<NU, NL>(_vehicle.surface[k][n], u, l);

				for (int j = 0; j < 4; j++) { left[j] -= _vehicle.gain[k][n][j] * f; }
			}

			power += _still[2 * k + 1] ? value<PU, 0>(_vehicle.still_power[k], u, 0)
				 : value<PU, PL>(_cost[k], u, l);
		}
	}

	void fresh_miss() { work++; missing(state.x, miss, _power); }

	void expand()
	{
		work++;

		for (int j = 0; j < 4; j++) { miss[j] = mu[j]; }

		for (int k = 0; k < K; k++) { expand_arm(k); }
	}

	void expand_arm(int k)
	{
		const Real u = state.x[2 * k], l = state.x[2 * k + 1];
		Real *by_u = _jacobian[2 * k], *by_l = _jacobian[2 * k + 1];

		for (int j = 0; j < 4; j++) { by_u[j] = by_l[j] = 0; }

		const bool still = _still[2 * k + 1];
		Real p[6];

		if (still) { surface<PU, 0>(_vehicle.still_power[k], u, 0, p); }
		else { surface<PU, PL>(_cost[k], u, l, p); }

		Real gu = p[1], gl = p[2], uu = p[3], ul = p[4], ll = p[5];

		for (int n = 0; n < M; n++) {
			Real f[6];

			if (still) { surface<NU, 0>(_vehicle.still_surface[k][n], u, 0, f); }
			else { surface<NU, NL>(_vehicle.surface[k][n], u, l, f); }

			Real weight = 0;

			for (int j = 0; j < 4; j++) {
				const Real g = _vehicle.gain[k][n][j];
				miss[j] -= g * f[0];
				by_u[j] += g * f[1];
				by_l[j] += g * f[2];
				weight -= g * state.price[j];
			}

			uu += weight * f[3];
			ul += weight * f[4];
			ll += weight * f[5];
		}

		if (uu < CURVATURE || ll < CURVATURE || (uu - CURVATURE) * (ll - CURVATURE) < ul * ul) {
			const Real half = Real(0.5) * (uu - ll);
			const Real shift = CURVATURE - Real(0.5) * (uu + ll) + std::sqrt(half * half + ul * ul);
			uu += shift;
			ll += shift;
		}

		_slope[2 * k] = gu;
		_slope[2 * k + 1] = gl;
		_hessian[k][0] = uu;
		_hessian[k][1] = ul;
		_hessian[k][2] = ll;
	}

	// change of merit (power plus the price of what is missing) from one place to another, axis by axis: the whole
	// sums, a million times a miss, have no digits left for the power
	Real worth(const Real before[4], Real power_before, const Real after[4], Real power_after) const
	{
		Real gain = power_before - power_after;

		for (int j = 0; j < 4; j++) {
			const Real d = magnitude(before[j]) - magnitude(after[j]);

			if (magnitude(d) > L::MISS || !L::SINGLE) { gain += _vehicle.cap[j] * d; }
		}

		return gain;
	}

	// the merit of x, for a scale
	Real dearness() const
	{
		Real total = _power;

		for (int j = 0; j < 4; j++) { total += _vehicle.cap[j] * magnitude(miss[j]); }

		return total;
	}

	void move()
	{
		for (int i = 0; i < N; i++) { state.x[i] = clip(state.x[i] + _step[i], _lo[i], _hi[i]); }
	}

	Real largest_step() const
	{
		Real most = 0;

		for (int i = 0; i < N; i++) { most = larger(most, magnitude(_step[i])); }

		return most;
	}

	Real worst_met() const
	{
		Real worst = 0;

		for (int j = 0; j < 4; j++) { if (state.gone[j] == 0) { worst = larger(worst, magnitude(miss[j])); } }

		return worst;
	}

	// the Schur complement of one quadratic problem, for a given active set

	void assemble(const Real *lo, const Real *hi)
	{
		work++;

		for (int i = 0; i < 4; i++) {
			_right[i] = miss[i];

			for (int j = 0; j <= i; j++) { _schur[i][j] = 0; }
		}

		for (int k = 0; k < K; k++) {
			const Real uu = _hessian[k][0], ul = _hessian[k][1], ll = _hessian[k][2];
			const int i = 2 * k, j = i + 1;
			const Real gu = _slope[i], gl = _slope[j];
			Real a = 0, b = 0, d = 0, own_u, own_l;

			if (state.act[i] == 0 && state.act[j] == 0) {
				const Real r = Real(1) / (uu * ll - ul * ul);
				a = r * ll; b = -r * ul; d = r * uu;
				own_u = -(a * gu + b * gl);
				own_l = -(b * gu + d * gl);

			} else {
				own_u = (state.act[i] < 0 ? lo[i] : hi[i]) - state.x[i];
				own_l = (state.act[j] < 0 ? lo[j] : hi[j]) - state.x[j];

				if (state.act[i] == 0) {
					a = Real(1) / uu;
					own_u = -a * (gu + ul * own_l);

				} else if (state.act[j] == 0) {
					d = Real(1) / ll;
					own_l = -d * (gl + ul * own_u);
				}
			}

			_own[i] = own_u;
			_own[j] = own_l;
			const Real *by_u = _jacobian[i], *by_l = _jacobian[j];

			for (int m = 0; m < 4; m++) {
				_reply[i][m] = a * by_u[m] + b * by_l[m];
				_reply[j][m] = b * by_u[m] + d * by_l[m];
				_right[m] -= by_u[m] * own_u + by_l[m] * own_l;

				for (int n = 0; n <= m; n++) { _schur[m][n] += by_u[m] * _reply[i][n] + by_l[m] * _reply[j][n]; }
			}
		}
	}

	void fix_price(int j, Real price)
	{
		for (int i = 0; i < 4; i++) {
			if (i > j) {
				_right[i] -= _schur[i][j] * price;
				_schur[i][j] = 0;

			} else if (i < j) {
				_right[i] -= _schur[j][i] * price;
				_schur[j][i] = 0;
			}
		}

		_schur[j][j] = 1;
	}

	void fix_given_up()
	{
		for (int j = 0; j < 4; j++) { if (state.gone[j]) { fix_price(j, sign(state.gone[j]) * _vehicle.cap[j]); } }

		for (int j = 0; j < 4; j++) { if (state.gone[j]) { _right[j] = sign(state.gone[j]) * _vehicle.cap[j]; } }
	}

	// whether no axis is stuck; a stuck one is left unmoved
	bool factor(Real tiny)
	{
		bool sound = true;

		for (int j = 0; j < 4; j++) {
			Real d = _schur[j][j];

			for (int n = 0; n < j; n++) {
				Real t = _schur[j][n];

				for (int m = 0; m < n; m++) { t -= _factor[j][m] * _factor[n][m]; }

				_factor[j][n] = t;
			}

			for (int n = 0; n < j; n++) {
				const Real t = _factor[j][n];
				_factor[j][n] = t * _factor[n][n];
				d -= t * _factor[j][n];
			}

			if (d <= L::NO_PIVOT || d <= tiny * _schur[j][j]) {
				sound = false;
				_factor[j][j] = 0;

			} else {
				_factor[j][j] = Real(1) / d;
			}
		}

		return sound;
	}

	void substitute(const Real b[4], Real v[4]) const
	{
		Real t[4];

		for (int i = 0; i < 4; i++) {
			t[i] = b[i];

			for (int j = 0; j < i; j++) { t[i] -= _factor[i][j] * t[j]; }
		}

		for (int i = 3; i >= 0; i--) {
			v[i] = t[i] * _factor[i][i];

			for (int j = i + 1; j < 4; j++) { v[i] -= _factor[j][i] * v[j]; }
		}
	}

	void correct()
	{
		Real b[4], v[4];

		for (int j = 0; j < 4; j++) { b[j] = state.gone[j] ? Real(0) : miss[j]; }

		substitute(b, v);

		for (int i = 0; i < N; i++) {
			_step[i] = v[0] * _reply[i][0] + v[1] * _reply[i][1] + v[2] * _reply[i][2] + v[3] * _reply[i][3];
		}

		move();
	}

	// one quadratic problem: prices, step, active set

	// settles bounds and given-up axes; false where only the sure way would, and it is not `allowed`
	bool quadratic_step(bool allowed)
	{
		for (int round = 0; round < ROUNDS; round++) {
			assemble(_lo, _hi);
			fix_given_up();

			if (!factor(L::TINY)) { break; }

			substitute(_right, state.price);

			for (int i = 0; i < N; i++) {
				const Real *r = _reply[i];
				_step[i] = _own[i] + state.price[0] * r[0] + state.price[1] * r[1] + state.price[2] * r[2] + state.price[3] * r[3];
			}

			if (priced_out()) { break; }

			if (!revise()) { return true; }
		}

		if (!allowed) { return false; }

		climb(_lo, _hi);
		assemble(_lo, _hi);
		fix_given_up();
		factor(L::SETTLED_TINY);
		return true;
	}

	bool priced_out() const
	{
		for (int j = 0; j < 4; j++) {
			if (state.gone[j]) {
				Real left = miss[j];

				for (int i = 0; i < N; i++) { left -= _jacobian[i][j] * _step[i]; }

				if (left * sign(state.gone[j]) < Real(0)) { return true; }

			} else if (magnitude(state.price[j]) > _vehicle.cap[j]) {
				return true;
			}
		}

		return false;
	}

	bool revise()
	{
		bool changed = false;

		for (int i = 0; i < N; i++) {
			if (_hi[i] <= _lo[i]) { continue; }

			if (state.act[i] == 0) {
				const Real to = state.x[i] + _step[i];

				if (to < _lo[i] - L::BOUND) { state.act[i] = -1; changed = true; }
				else if (to > _hi[i] + L::BOUND) { state.act[i] = 1; changed = true; }

			} else {
				const Real *block = _hessian[i / 2], *by = _jacobian[i];
				const Real here = i % 2 ? block[2] : block[0], other = _step[i ^ 1];
				Real push = block[1] * other + here * _step[i] + _slope[i];
				Real of = magnitude(push) + magnitude(_slope[i]);

				for (int j = 0; j < 4; j++) {
					push -= state.price[j] * by[j];
					of += magnitude(state.price[j] * by[j]);
				}

				if (push * sign(state.act[i]) > L::PUSH * (L::SINGLE ? of : Real(1))) { state.act[i] = 0; changed = true; }
			}
		}

		return changed;
	}

	// the sure way through one quadratic problem: Newton on its concave dual in four prices

	void climb(const Real *lo, const Real *hi)
	{
		for (int j = 0; j < 4; j++) { state.price[j] = clip(state.price[j], -_vehicle.cap[j], _vehicle.cap[j]); }

		dual_slope(lo, hi);

		for (int count = 0; count < CLIMBS && !spent(); count++) {
			Real worst = 0;

			for (int j = 0; j < 4; j++) {
				state.gone[j] = 0;

				if (magnitude(state.price[j]) >= _vehicle.cap[j] && _dual[j] * state.price[j] > Real(0)) {
					state.gone[j] = state.price[j] > Real(0) ? 1 : -1;

				} else {
					worst = larger(worst, magnitude(_dual[j]));
				}
			}

			if (worst < L::DUAL) { return; }

			ascent(lo, hi);
			along(lo, hi);
		}
	}

	void dual_slope(const Real *lo, const Real *hi)
	{
		work++;

		for (int j = 0; j < 4; j++) { _dual[j] = miss[j]; }

		for (int k = 0; k < K; k++) {
			box_arm(k, lo, hi);

			for (int i = 2 * k; i < 2 * k + 2; i++) {
				for (int j = 0; j < 4; j++) { _dual[j] -= _jacobian[i][j] * _step[i]; }
			}
		}
	}

	void box_arm(int k, const Real *lo, const Real *hi)
	{
		const int i = 2 * k;
		const Real uu = _hessian[k][0], ul = _hessian[k][1], ll = _hessian[k][2];
		Real gu = _slope[i], gl = _slope[i + 1];

		for (int j = 0; j < 4; j++) {
			gu -= state.price[j] * _jacobian[i][j];
			gl -= state.price[j] * _jacobian[i + 1][j];
		}

		const Real u_lo = lo[i] - state.x[i], u_hi = hi[i] - state.x[i], l_lo = lo[i + 1] - state.x[i + 1], l_hi = hi[i + 1] - state.x[i + 1];
		const Real det = uu * ll - ul * ul;
		Real du = (ul * gl - ll * gu) / det, dl = (ul * gu - uu * gl) / det;
		int act_u = 0, act_l = 0;

		if (!(u_lo <= du && du <= u_hi && l_lo <= dl && dl <= l_hi) || u_hi <= u_lo || l_hi <= l_lo) {
			Real best = Real(3e38);

			for (int edge = 0; edge < 4; edge++) {
				Real u, l;
				int au = 0, al = 0;

				if (edge < 2) {
					u = edge == 0 ? u_lo : u_hi;
					au = edge == 0 ? -1 : 1;
					l = -(gl + ul * u) / ll;

					if (l <= l_lo) { l = l_lo; al = -1; }
					else if (l >= l_hi) { l = l_hi; al = 1; }

				} else {
					l = edge == 2 ? l_lo : l_hi;
					al = edge == 2 ? -1 : 1;
					u = -(gu + ul * l) / uu;

					if (u <= u_lo) { u = u_lo; au = -1; }
					else if (u >= u_hi) { u = u_hi; au = 1; }
				}

				const Real cost = u * (gu + Real(0.5) * uu * u + ul * l) + l * (gl + Real(0.5) * ll * l);

				if (cost < best) { best = cost; du = u; dl = l; act_u = au; act_l = al; }
			}
		}

		_step[i] = du;
		_step[i + 1] = dl;
		state.act[i] = act_u;
		state.act[i + 1] = act_l;
	}

	void ascent(const Real *lo, const Real *hi)
	{
		for (int pass = 0; pass < 4; pass++) {
			assemble(lo, hi);

			for (int j = 0; j < 4; j++) {
				_right[j] = _dual[j];
				_schur[j][j] += L::RIDGE;
			}

			for (int j = 0; j < 4; j++) {
				if (state.gone[j]) {
					fix_price(j, Real(0));
					_right[j] = 0;
				}
			}

			factor(Real(0));
			Real v[4];
			substitute(_right, v);
			bool beyond = false;

			for (int j = 0; j < 4; j++) {
				_right[j] = v[j];

				if (state.gone[j] == 0 && magnitude(state.price[j]) >= _vehicle.cap[j] && v[j] * state.price[j] > Real(0)) {
					state.gone[j] = state.price[j] > Real(0) ? 1 : -1;
					beyond = true;
				}
			}

			if (!beyond) { return; }
		}
	}

	void along(const Real *lo, const Real *hi)
	{
		Real reach = 1, start = 0, before[4];
		int first = -1;

		for (int j = 0; j < 4; j++) {
			const Real d = _right[j];

			if (magnitude(d) > Real(0)) {
				const Real most = ((d > Real(0) ? _vehicle.cap[j] : -_vehicle.cap[j]) - state.price[j]) / d;

				if (most < reach) { reach = most; first = j; }
			}

			start += d * _dual[j];
			before[j] = state.price[j];
		}

		Real low = 0, high = reach, t = reach, at_low = start, at_high = 0;
		bool whole = true;

		for (int cut = 0; cut < CUTS && !spent(); cut++) {
			for (int j = 0; j < 4; j++) { state.price[j] = before[j] + t * _right[j]; }

			if (first >= 0 && whole) { state.price[first] = _right[first] > Real(0) ? _vehicle.cap[first] : -_vehicle.cap[first]; }

			dual_slope(lo, hi);
			Real rise = 0;

			for (int j = 0; j < 4; j++) { rise += _right[j] * _dual[j]; }

			if (magnitude(rise) <= Real(0.01) * start || (cut == 0 && rise >= Real(0))) { return; }

			if (rise > Real(0)) { low = t; at_low = rise; }
			else { high = t; at_high = rise; }

			t = cut % 2 ? Real(0.5) * (low + high) : low + (high - low) * at_low / (at_low - at_high);
			whole = false;
		}
	}

	// from one quadratic problem to the next

	bool settle(bool climbing)
	{
		Real step = 0;
		int count = 0;

		while (!spent() && (count < STEPS || (count < STEPS + GRACE && step < SETTLING))) {
			count++;
			steps++;
			expand();

			if (!quadratic_step(climbing)) { return false; }

			step = largest_step();
			move();
			fresh_miss();
			Real worst = worst_met();

			if (step < (given_up() ? L::GIVEN_UP_DONE : STEP_DONE)) {
				for (int c = 0; c < CORRECTIONS && worst > L::MISS; c++) {
					correct();
					fresh_miss();
					worst = worst_met();
				}

				if (worst <= L::MISS) { return true; }
			}
		}

		return false;
	}

	// steps inside a trust region that grows and shrinks with what they bring; false when the budget is spent
	bool persist()
	{
		Real low[N], high[N], kept[N], miss_here[4];
		fresh_miss();

		for (; _left > 0; _left--) {
			if (spent()) { return false; }

			steps++;
			expand();
			const Real power_here = _power;

			for (int i = 0; i < N; i++) {
				low[i] = larger(_lo[i], state.x[i] - _radius);
				high[i] = clip(state.x[i] + _radius, _lo[i], _hi[i]);
				kept[i] = state.x[i];
			}

			for (int j = 0; j < 4; j++) { miss_here[j] = miss[j]; }

			climb(low, high);
			const Real gain = promise(), step = largest_step();

			if (gain < L::GAIN || step < L::STEP) { return true; }

			move();
			fresh_miss();
			Real got = worth(miss_here, power_here, miss, _power);

			if (got < Real(0.5) * gain) {
				assemble(low, high);
				fix_given_up();

				if (!factor(L::TINY)) {
					correct();
					fresh_miss();
					got = worth(miss_here, power_here, miss, _power);
				}
			}

			if (got > Real(0.05) * gain) {
				if (got > Real(0.5) * gain && step > Real(0.7) * _radius) { _radius = clip(Real(2) * _radius, Real(0), Real(1)); }

			} else {
				for (int i = 0; i < N; i++) { state.x[i] = kept[i]; }

				for (int j = 0; j < 4; j++) { miss[j] = miss_here[j]; }

				_power = power_here;
				_radius = Real(0.3) * (_radius < step ? _radius : step);
			}
		}

		return true;
	}

	Real promise() const
	{
		Real gain = 0;

		for (int k = 0; k < K; k++) {
			const Real du = _step[2 * k], dl = _step[2 * k + 1];
			gain -= du * (_slope[2 * k] + Real(0.5) * _hessian[k][0] * du + _hessian[k][1] * dl);
			gain -= dl * (_slope[2 * k + 1] + Real(0.5) * _hessian[k][2] * dl);
		}

		for (int j = 0; j < 4; j++) {
			const Real d = magnitude(miss[j]) - magnitude(_dual[j]);

			if (magnitude(d) > L::MISS || !L::SINGLE) { gain += _vehicle.cap[j] * d; }
		}

		return gain;
	}

	// where a call starts

	Real away(int which) const
	{
		Real distance = 0;

		for (int j = 0; j < 4; j++) { distance += magnitude(mu[j] - state.mu[which][j]); }

		return distance;
	}

	void remember(int which)
	{
		for (int j = 0; j < 4; j++) {
			state.mu[which][j] = state.mu[LAST][j];
			state.old_price[which][j] = state.price[j];
			state.old_gone[which][j] = state.gone[j];
		}

		for (int i = 0; i < N; i++) { state.old_x[which][i] = state.x[i]; state.old_act[which][i] = state.act[i]; }
	}

	void recall(int which)
	{
		for (int j = 0; j < 4; j++) { state.price[j] = state.old_price[which][j]; state.gone[j] = state.old_gone[which][j]; }

		for (int i = 0; i < N; i++) { state.x[i] = state.old_x[which][i]; state.act[i] = state.old_act[which][i]; }
	}

	void start()
	{
		const Real jump = away(LAST);

		if (_stage != CLOSE && jump < JUMP) {
			state.smooth = 0;  // it goes on where it was cut short

		} else if (jump < JUMP) {
			for (int i = 0; i < N; i++) {
				const Real at = state.x[i];
				state.x[i] = at + larger(state.smooth, Real(0)) * (at - state.old_x[LAST][i]);
				state.old_x[LAST][i] = at;
			}

			state.smooth = 1;

		} else {
			const bool out = given_up();

			if (state.mu[LAST][0] < NEVER) { remember(out ? BEYOND : WITHIN); }

			const int other = out ? WITHIN : BEYOND;

			if (CLEARLY * away(other) < jump) { recall(other); }

			state.smooth = out || jump > LEAP ? Real(-1) : Real(0);
			_stage = CLOSE;
		}

		for (int j = 0; j < 4; j++) { state.mu[LAST][j] = mu[j]; }

		for (int i = 0; i < N; i++) {
			state.x[i] = clip(state.x[i], _lo[i], _hi[i]);

			if (_hi[i] <= _lo[i]) { state.act[i] = -1; }
		}
	}

	void stand(const Real *x)
	{
		for (int i = 0; i < N; i++) {
			state.x[i] = clip(x[i], _lo[i], _hi[i]);
			state.act[i] = _hi[i] > _lo[i] ? 0 : -1;
		}

		for (int j = 0; j < 4; j++) { state.price[j] = 0; state.gone[j] = 0; }
	}

	// an axis is missed by more than what is no fault
	bool faulty() const
	{
		for (int j = 0; j < 4; j++) { if (magnitude(miss[j]) > _vehicle.within) { return true; } }

		return false;
	}

	// the last look all round was made so near that it still holds: what was missed there is missed here
	bool known() const
	{
		Real distance = 0;
		bool same = true;

		for (int j = 0; j < 4; j++) {
			distance += magnitude(mu[j] - _looked[j]);
			same = same && state.gone[j] == _looked_gone[j];
		}

		return _looked_at < NEVER && same && distance < JUMP;
	}

	// whether an upper or a lone rotor that could turn is held at its least
	bool stands() const
	{
		for (int k = 0; k < K; k++) {
			if (state.act[2 * k] < 0 && _hi[2 * k] > _lo[2 * k]) { return true; }
		}

		return false;
	}

	// keep x, whose miss is known, if it is better than the best so far at this demand; whether it is
	bool keep(bool first)
	{
		if (!first) {
			Real left[4], power;
			missing(_best, left, power);

			if (worth(left, power, miss, _power) < Real(0)) { return false; }
		}

		for (int i = 0; i < N; i++) { _best[i] = state.x[i]; }

		return true;
	}

	// the active set and the prices of the best, and back to it
	void keep_working()
	{
		for (int j = 0; j < 4; j++) { state.old_price[LAST][j] = state.price[j]; state.old_gone[LAST][j] = state.gone[j]; }

		for (int i = 0; i < N; i++) { state.old_act[LAST][i] = state.act[i]; }
	}

	void work_again()
	{
		for (int j = 0; j < 4; j++) { state.price[j] = state.old_price[LAST][j]; state.gone[j] = state.old_gone[LAST][j]; }

		for (int i = 0; i < N; i++) { state.x[i] = _best[i]; state.act[i] = state.old_act[LAST][i]; }

		fresh_miss();
	}

	// hover, the reduced mixer's answer, both bounds
	void stand_at(int start)
	{
		if (start == 0) { stand(_vehicle.home); }

		else if (start == 1) {
			Real other[N];
			reduced(other);
			stand(other);
			fresh_miss();
			keep(false);
		}

		else { stand(start == 2 ? _hi : _lo); }

		_radius = Real(0.3);
		_left = PERSIST;
		_stage = SURE;
	}

	// `settle` from the last solution; then from hover; then the sure way from several starts, and `settle` from where
	// each led: the best of all. What the budget cuts short goes on in the next call, at the stage where it stood.
	bool optimum()
	{
		if (_stage == CLOSE) {
			const bool near = settle(true);
			_delivered = near && !faulty();
			_near = near;
			_stood = stands();

			if ((_delivered && state.smooth >= Real(0) && !_stood) || (near && known())) { return true; }

			fresh_miss();
			keep(true);
			keep_working();
			_stage = MIDDLE;
		}

		if (_stage == MIDDLE && !spent()) {
			stand(_vehicle.home);
			const bool there = settle(true);
			fresh_miss();

			// after a jump the same wrench may be had at less power near hover; a rotor that stands has to start
			// again, and no stand has measured its pair: only where nothing else delivers
			if (_delivered) {
				const bool turns = there && !faulty() && _stood && !stands();

				if (!turns && (!there || faulty() || !keep(false))) { work_again(); }

				return done();
			}

			if (there && !faulty()) { return done(); }

			// two ways to one end: no other start is likely to deliver more
			Real left[4], power;
			missing(_best, left, power);
			const Real apart = worth(left, power, miss, _power);
			keep(false);

			if (_near && there && magnitude(apart) < Real(1e-6) * larger(dearness(), Real(1))) { return look_done(); }

			_start = 0;
			looks++;
			stand_at(0);
		}

		while (!spent()) {
			if (_stage == SURE) {
				if (!persist()) { return false; }

				fresh_miss();
				keep(false);
				_stage = LAST_STEPS;
			}

			const bool there = settle(true);

			if (!there && spent()) { return false; }

			fresh_miss();
			keep(false);

			if ((there && !faulty() && _start < 2) || ++_start == STARTS) { return look_done(); }

			stand_at(_start);
		}

		return false;
	}

	bool look_done()
	{
		_looked_at = 0;
		stand(_best);
		settle(true);  // active set and prices for the next call

		for (int j = 0; j < 4; j++) { _looked[j] = mu[j]; _looked_gone[j] = state.gone[j]; }

		fresh_miss();
		keep(false);

		for (int i = 0; i < N; i++) { state.x[i] = _best[i]; }

		return done();
	}

	bool done()
	{
		_stage = CLOSE;
		return true;
	}

	void reduced(Real *at) const
	{
		Real speeds[N];

		for (int i = 0; i < N; i++) {
			Real squared = 0;

			for (int j = 0; j < 4; j++) { squared += _vehicle.reduced[i][j] * mu[j]; }

			speeds[i] = std::sqrt(larger(squared, Real(0)));

			if (i % 2 == 0) { speeds[i] = clip(speeds[i], _lo[i], _hi[i]); }
		}

		placed(speeds, at);
	}

	// the reduced mixer, where it is the better: also than another optimum far from the best
	bool prefer_reduced()
	{
		Real other[N];
		reduced(other);
		return prefer(other);
	}

	bool prefer(const Real *other)
	{
		Real at[N], left[4], power;

		for (int i = 0; i < N; i++) { at[i] = clip(other[i], _lo[i], _hi[i]); }

		work++;
		missing(at, left, power);

		if (!(worth(miss, _power, left, power) > Real(0))) { return false; }

		answer(at);

		for (int j = 0; j < 4; j++) { miss[j] = left[j]; }

		_power = power;
		return true;
	}

	const int32_t _budget;
	const Numbers &_vehicle;
	Real _cost[K][(PU + 1) * (PL + 1)] {};
	Real _lo[N] {}, _hi[N] {};
	bool _still[N] {};
	Real _power = 0, _radius = 0;
	int _stage = CLOSE, _left = 0, _start = 0;
	bool _delivered = false, _near = false, _stood = false;
	Real _answer[N] {}, _best[N] {}, _looked[4] {}, _looked_at = NEVER;
	int _looked_gone[4] {};
	Real _slope[N] {}, _jacobian[N][4] {}, _hessian[K][3] {};
	Real _own[N] {}, _reply[N][4] {}, _step[N] {};
	Real _schur[4][4] {}, _factor[4][4] {}, _right[4] {}, _dual[4] {};
};

// The law on board: single precision while it can, double where it cannot (see the top).
template<int K, int M, int NU, int NL, int PU, int PL> class ExactLaw
{
public:
	static constexpr int N = 2 * K;

	ExactLaw(const Vehicle<float, K, M, NU, NL, PU, PL> &single, const Vehicle<double, K, M, NU, NL, PU, PL> &wide,
		 int32_t budget) :
		_near(single, budget), _sure(wide, budget) {}

	// See Law.
	void lean(float by)
	{
		_near.lean(by);
		_sure.lean(static_cast<double>(by));
	}

	// Forget the last solution; slots of `failed` (bit i: speed i) stand still from now on.
	void without(uint32_t failed)
	{
		_near.without(failed);
		_sure.without(failed);
		_far = false;
	}

	// The best speeds for a demand (4) by rank; returns whether they are settled. Always finite and within the bounds.
	bool solve(const float demand[4])
	{
		double wide[4];

		for (int j = 0; j < 4; j++) { wide[j] = static_cast<double>(demand[j]); }

		work = 0;

		if (!_far) {
			_before = _near.state;
			settled = _near.solve_near(demand);
			work = _near.work;

			if (settled) {
				tell(_near);
				return true;
			}

			_sure.state.adopt(_before);
		}

		settled = _sure.solve(wide);
		work += _sure.work;
		tell(_sure);
		_far = !settled || _sure.state.gone[0] || _sure.state.gone[1] || _sure.state.gone[2];

		if (!_far) { _near.state.adopt(_sure.state); }

		return settled;
	}

	// What speeds deliver, by rank.
	void deliver(const float speeds[], float out[4]) const { _near.deliver(speeds, out); }

	float speed[N] {};       // the answer
	float mu[4] {};          // the demand, held to what is sane
	float miss[4] {};        // demanded minus delivered, by rank
	int32_t work = 0;        // passes over the arms that the last call took
	bool settled = false;
	bool fell_back = false;  // to the reduced mixer
	int32_t looks = 0;       // all round, since start

private:
	template<typename Of> void tell(const Of &law)
	{
		for (int i = 0; i < N; i++) { speed[i] = static_cast<float>(law.speed[i]); }

		for (int j = 0; j < 4; j++) { mu[j] = static_cast<float>(law.mu[j]); miss[j] = static_cast<float>(law.miss[j]); }

		fell_back = law.fell_back;
		looks = _sure.looks;
	}

	Law<float, K, M, NU, NL, PU, PL> _near;
	Law<double, K, M, NU, NL, PU, PL> _sure;
	State<float, K> _before;
	bool _far = false;
};

}  // namespace coaxlink
