#include "CoaxMixer.hpp"

#include <px4_platform_common/log.h>
#include <px4_platform_common/module.h>
#include <px4_platform_common/time.h>
#include <systemlib/mavlink_log.h>
#include <uORB/uORB.h>

#include <cmath>
#include <cstring>

using namespace coaxlink;

namespace
{

int32_t whole(const char *name, int32_t otherwise)
{
	const param_t handle = param_find(name);
	int32_t value = otherwise;
	return handle != PARAM_INVALID && param_get(handle, &value) == 0 ? value : otherwise;
}

float real(const char *name, float otherwise)
{
	const param_t handle = param_find(name);
	float value = otherwise;
	return handle != PARAM_INVALID && param_get(handle, &value) == 0 ? value : otherwise;
}

}  // namespace

CoaxMixer::CoaxMixer() :
	px4::WorkItem("coax_mixer", px4::wq_configurations::rate_ctrl),
	_cycle(perf_alloc(PC_ELAPSED, "coax_mixer: cycle"))
{
}

CoaxMixer::~CoaxMixer()
{
	perf_free(_cycle);
}

bool CoaxMixer::init()
{
	if (!whole("COAX_EN", 1)) { PX4_WARN("COAX_EN is 0"); return false; }

	if (whole("CA_AIRFRAME", 0) != 0) { PX4_ERR("CA_AIRFRAME is not 0 (multirotor)"); return false; }

	if (whole("CA_ROTOR_COUNT", 0) != ROTORS) { PX4_ERR("CA_ROTOR_COUNT is not %d, as this module's vehicle", ROTORS); return false; }

	if (whole("CA_R_REV", 0) != 0) { PX4_ERR("CA_R_REV: reversible motors are not known to it"); return false; }

	for (int i = 0; i < ROTORS; i++) {
		char name[17];
		snprintf(name, sizeof(name), "CA_R%d_SLEW", i);

		if (real(name, 0.f) > 0.f) { PX4_ERR("%s: slew limits are not known to it", name); return false; }
	}

	// a publisher that stops takes the topic from all readers, whoever else publishes it
	if (orb_exists(ORB_ID(actuator_motors), 0) == 0) { PX4_ERR("first: control_allocator stop"); return false; }

	vehicle_control_mode_s mode;

	if (_mode_sub.copy(&mode) && mode.flag_armed) { PX4_ERR("armed"); return false; }

	read_parameters();

	if (_share.begin(real("COAX_SHARE", 0.f), real("COAX_SHARE_TRY", 0.f))) { refuse_share(); }

	_law.without(0);
	return _torque_sub.registerCallback();
}

void CoaxMixer::read_parameters()
{
	const float curve = real("THR_MDL_FAC", 0.f);
	_curve = curve > 1e-6f && curve <= 1.f ? curve : 0.f;
	_follow = whole("COAX_COMP", 1) != 0;
	const int32_t longest = whole("COAX_TIMEOUT", 20);
	// as module.yaml says: below two demands and a round trip a companion is handed back again and again
	_companion.longest_us = 1000U * static_cast<uint32_t>(longest < 10 ? 10 : (longest > 100 ? 100 : longest));
	_system = whole("MAV_SYS_ID", 1);
	_handle_failures = whole("CA_FAILURE_MODE", 0) > 0;
}

void CoaxMixer::request_stop()
{
	_stop.store(true);
	ScheduleNow();
}

void CoaxMixer::Run()
{
	if (_stop.load()) {
		_torque_sub.unregisterCallback();
		_stopped.store(true);
		return;
	}

	vehicle_torque_setpoint_s torque;

	if (!_torque_sub.update(&torque)) { return; }

	perf_begin(_cycle);

	if (_parameter_sub.updated()) {
		parameter_update_s update;
		_parameter_sub.copy(&update);
		read_parameters();

		if (_share.take(real("COAX_SHARE", 0.f), real("COAX_SHARE_TRY", 0.f))) { refuse_share(); }
	}

	vehicle_control_mode_s mode;

	if (_mode_sub.update(&mode)) {
		_publish = mode.flag_control_allocation_enabled;
		_armed = mode.flag_armed;
		_offboard = mode.flag_control_offboard_enabled;
	}

	check_failures();
	take_setpoints(torque);
	take_share(hrt_absolute_time());

	float demand[4];

	for (int j = 0; j < 4; j++) {
		demand[j] = 0.f;

		for (int a = 0; a < 4; a++) { demand[j] += DEMAND<float>[j][a] * _setpoint[a]; }
	}

	if (!_law.solve(demand)) { _unsettled++; }

	if (_law.fell_back) { _fell_back++; }

	_most_work = _law.work > _most_work ? _law.work : _most_work;

	for (int i = 0; i < ROTORS; i++) { _speed[i] = _law.speed[SLOT[i]]; }

	const hrt_abstime now = hrt_absolute_time();
	take_answers(now);
	publish_motors(now, torque.timestamp_sample);

	// after the motors: nothing below may delay them
	if (now - _last_demand >= DEMAND_PERIOD_US) {
		_last_demand = now;
		publish_demand(now);
	}

	if (now - _last_status >= STATUS_PERIOD_US) {
		_last_status = now;
		publish_status(now);
	}

	perf_end(_cycle);
}

// As PX4's allocator with CA_FAILURE_MODE 1: the first motor that fails is taken out, until none is reported.
void CoaxMixer::check_failures()
{
	failure_detector_status_s status;

	if (!_handle_failures || !_failure_sub.update(&status)) { return; }

	const uint16_t mask = status.fd_motor ? status.motor_failure_mask : 0;
	uint32_t slots = 0;
	int count = 0;

	for (int i = 0; i < ROTORS; i++) {
		if ((mask >> i) & 1U) {
			slots |= 1U << SLOT[i];
			count++;
		}
	}

	if (mask == _failed || (mask != 0 && (_failed != 0 || count != 1))) { return; }

	_failed = mask;
	_companion.stopped = mask;
	_law.without(slots);
	PX4_WARN("motors out of the law: 0x%x", static_cast<unsigned>(mask));
}

void CoaxMixer::refuse_share()
{
	mavlink_log_warning(&_talk, "COAX_SHARE not flown: 0, or %.3f to %.3f\t", static_cast<double>(_share.least()),
			    static_cast<double>(_share.most()));
}

// Before the demand is solved. A dead rotor's arm has no split.
void CoaxMixer::take_share(hrt_abstime now)
{
	offboard_control_mode_s offboard;
	const bool fresh = _offboard_sub.copy(&offboard) && now < offboard.timestamp + SETPOINT_US;
	const float dt = static_cast<float>(now - _last_run) * 1e-6f;
	const float lean = _share.lean(dt < 0.02f ? dt : 0.02f, _armed && _offboard && fresh && _failed == 0);

	if (std::fabs(lean - _lean) > 0.f) { _law.lean(_lean = lean); }
}

// What is not finite is not taken: the last whole demand stays.
void CoaxMixer::take_setpoints(const vehicle_torque_setpoint_s &torque)
{
	vehicle_thrust_setpoint_s thrust;
	float fresh[4] = {torque.xyz[0], torque.xyz[1], torque.xyz[2], _setpoint[3]};

	if (_thrust_sub.update(&thrust)) { fresh[3] = -thrust.xyz[2]; }

	for (int a = 0; a < 4; a++) {
		if (std::isfinite(fresh[a])) { _setpoint[a] = fresh[a]; }
		else { _not_finite++; }
	}
}

void CoaxMixer::take_answers(hrt_abstime now)
{
	static_assert(sizeof(mavlink_tunnel_s::payload) >= Companion<ROTORS>::LENGTH, "rotors fit one TUNNEL");
	mavlink_tunnel_s tunnel;

	auto deliver = [this](const float *by_rotor, float delivered[4]) {
		float by_slot[2 * ARMS] {};

		for (int i = 0; i < ROTORS; i++) { by_slot[SLOT[i]] = by_rotor[i]; }

		_law.deliver(by_slot, delivered);
	};

	// a queue of eight: never more than were there when it began
	for (int i = 0; i < 8 && _tunnel_sub.update(&tunnel); i++) {
		if (!_follow || tunnel.payload_type != PAYLOAD_TYPE) { continue; }

		_companion.hear(now, tunnel.payload, tunnel.payload_length, tunnel.target_system == _system, deliver);
	}

	const float dt = static_cast<float>(now - _last_run) * 1e-6f;
	_last_run = now;
	_companion.blend(now, dt < 0.02f ? dt : 0.02f, _follow, _speed);
}

// PX4's output functions bend what is published by THR_MDL_FAC; the commands that turn the law's speeds are bent back beforehand.
void CoaxMixer::publish_motors(hrt_abstime now, hrt_abstime sample)
{
	actuator_motors_s motors{};
	motors.timestamp = now;
	motors.timestamp_sample = sample;

	for (float &control : motors.control) { control = NAN; }

	float by_slot[2 * ARMS] {};

	for (int i = 0; i < ROTORS; i++) { by_slot[SLOT[i]] = std::isfinite(_speed[i]) ? _speed[i] : 0.f; }

	for (int i = 0; i < ROTORS; i++) {
		const float u = command(by_slot, SLOT[i]);
		_command[i] = u;

		if (std::isfinite(_speed[i]) && std::isfinite(u) && !((_failed >> i) & 1U)) {
			motors.control[i] = _curve * u * u + (1.f - _curve) * u;
		}
	}

	if (_publish) { _motors_pub.publish(motors); }
}

// What the law could not deliver, in setpoints: it stops the rate loops' integrators and corrects the hover thrust.
void CoaxMixer::publish_status(hrt_abstime now)
{
	constexpr float ACHIEVED = 1e-3f;  // as PX4's allocator judges it
	control_allocator_status_s status{};
	status.timestamp = now;
	float left[4];

	for (int a = 0; a < 4; a++) {
		left[a] = 0.f;

		for (int j = 0; j < 4; j++) { left[a] += SETPOINT<float>[a][j] * _law.miss[j]; }

		if (std::fabs(left[a]) < ACHIEVED) { left[a] = 0.f; }
	}

	for (int a = 0; a < 3; a++) { status.unallocated_torque[a] = left[a]; }

	status.unallocated_thrust[2] = -left[3];
	status.torque_setpoint_achieved = std::fabs(left[0]) + std::fabs(left[1]) + std::fabs(left[2]) < ACHIEVED;
	status.thrust_setpoint_achieved = std::fabs(left[3]) < ACHIEVED;

	for (int i = 0; i < ROTORS; i++) {
		if (_command[i] >= 1.f - 1e-6f) { status.actuator_saturation[i] = control_allocator_status_s::ACTUATOR_SATURATION_UPPER; }
		else if (_command[i] <= 1e-6f) { status.actuator_saturation[i] = control_allocator_status_s::ACTUATOR_SATURATION_LOWER; }
	}

	status.handled_motor_failure_mask = _failed;
	_status_pub.publish(status);
}

// data: roll, pitch, yaw, thrust; system and component followed; answers taken; number of the demand; identity of the
// vehicle; token followed; share of the companion; then one of the facts below in turn, as its number and its value;
// share of the upper rotors that is flown, whether it is a trial, the law's own, the least and the most of these rotors.
void CoaxMixer::publish_demand(hrt_abstime now)
{
	float delivered[4];

	for (int j = 0; j < 4; j++) { delivered[j] = _law.mu[j] - _law.miss[j]; }

	const uint32_t number = _companion.sent(now, delivered);
	const float facts[8] = {
		static_cast<float>(_companion.refused[0] % WHOLE), static_cast<float>(_companion.refused[1] % WHOLE),
		static_cast<float>(_companion.refused[2] % WHOLE), static_cast<float>(_companion.refused[3] % WHOLE),
		static_cast<float>(_companion.refused[4] % WHOLE), static_cast<float>(_companion.handed_back % WHOLE),
		static_cast<float>(_unsettled % WHOLE), static_cast<float>(_failed)
	};
	_told = (_told + 1) % 24;

	debug_array_s out{};
	out.timestamp = now;
	out.id = PAYLOAD_TYPE;
	strncpy(reinterpret_cast<char *>(out.name), "coax", sizeof(out.name) - 1);

	for (int a = 0; a < 4; a++) { out.data[a] = _setpoint[a]; }

	out.data[4] = static_cast<float>(_companion.system(now));
	out.data[5] = static_cast<float>(_companion.component(now));
	out.data[6] = static_cast<float>(_companion.taken);
	out.data[7] = static_cast<float>(number);
	out.data[8] = static_cast<float>(IDENTITY);
	out.data[9] = static_cast<float>(_companion.token(now));
	out.data[10] = _companion.share;
	out.data[11] = static_cast<float>(_told);
	out.data[12] = _told < 8 ? facts[_told] : WRENCH<float>[(_told - 8) / 4][(_told - 8) % 4];
	out.data[13] = _share.flown;
	out.data[14] = _share.tried() ? 1.f : 0.f;
	out.data[15] = OWN_SHARE;
	out.data[16] = _share.least();
	out.data[17] = _share.most();
	_demand_pub.publish(out);
}

void CoaxMixer::print_status()
{
	const Companion<ROTORS> &c = _companion;
	PX4_INFO("vehicle 0x%06x, %d rotors, %s", static_cast<unsigned>(IDENTITY), ROTORS, _publish ? "flying" : "idle");
	PX4_INFO("companion: share %.2f, taken %u, handed back %u, oldest %u us", static_cast<double>(c.share),
		 static_cast<unsigned>(c.taken), static_cast<unsigned>(c.handed_back), static_cast<unsigned>(c.oldest_us));
	PX4_INFO("refused: foreign %u, rival %u, invalid %u, stale %u, implausible %u", static_cast<unsigned>(c.refused[0]),
		 static_cast<unsigned>(c.refused[1]), static_cast<unsigned>(c.refused[2]), static_cast<unsigned>(c.refused[3]),
		 static_cast<unsigned>(c.refused[4]));
	PX4_INFO("share of the upper rotors: %.3f%s, %.3f the law's own, %.3f to %.3f can be had", static_cast<double>(_share.flown),
		 _share.tried() ? " on trial" : "", static_cast<double>(OWN_SHARE), static_cast<double>(_share.least()),
		 static_cast<double>(_share.most()));
	PX4_INFO("law: looked all round %d times, flew the reduced mixer %u times", static_cast<int>(_law.looks),
		 static_cast<unsigned>(_fell_back));
	PX4_INFO("law: unsettled %u, most passes %d of %d, not finite %u, failed motors 0x%x", static_cast<unsigned>(_unsettled),
		 static_cast<int>(_most_work), BUDGET, static_cast<unsigned>(_not_finite), static_cast<unsigned>(_failed));
	perf_print_counter(_cycle);
}

// start, stop, status

static CoaxMixer *running{nullptr};

static int start()
{
	if (running) { PX4_WARN("runs already"); return 0; }

	CoaxMixer *mixer = new CoaxMixer();

	if (!mixer) { PX4_ERR("no memory"); return -1; }

	if (!mixer->init()) { delete mixer; return -1; }

	running = mixer;
	return 0;
}

static int stop()
{
	if (!running) { PX4_INFO("not running"); return 0; }

	if (running->armed()) { PX4_ERR("armed"); return -1; }

	running->request_stop();

	for (int i = 0; i < 100 && !running->stopped(); i++) { px4_usleep(10000); }

	if (!running->stopped()) { PX4_ERR("does not stop"); return -1; }

	px4_usleep(10000);  // its last run returns
	delete running;
	running = nullptr;
	PX4_INFO("stopped; control_allocator start brings PX4's own back");
	return 0;
}

extern "C" __EXPORT int coax_mixer_main(int argc, char *argv[])
{
	const char *verb = argc > 1 ? argv[1] : "";

	if (strcmp(verb, "start") == 0) { return start(); }

	if (strcmp(verb, "stop") == 0) { return stop(); }

	if (strcmp(verb, "status") == 0) {
		if (running) { running->print_status(); }
		else { PX4_INFO("not running"); }

		return running ? 0 : -1;
	}

	PRINT_MODULE_USAGE_NAME("coax_mixer", "controller");
	PRINT_MODULE_USAGE_COMMAND("start");
	PRINT_MODULE_USAGE_DEFAULT_COMMANDS();
	return verb[0] ? -1 : 0;
}
