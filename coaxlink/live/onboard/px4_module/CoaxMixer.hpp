// coax_mixer: the exact law of one coaxial vehicle in the place of PX4's control allocator.
//
//   vehicle_torque_setpoint, vehicle_thrust_setpoint -> law -> actuator_motors, control_allocator_status
//   debug_array "coax": the demand, to a companion (DEBUG_FLOAT_ARRAY) and to the log
//   mavlink_tunnel of type PAYLOAD_TYPE: a companion's motor commands, flown while they are fresh
//   COAX_SHARE, COAX_SHARE_TRY: the share of the upper rotors (Share.hpp)
//
// Built outside PX4's tree (EXTERNAL_MODULES_LOCATION); nothing of PX4 is changed. Written for the messages of
// v1.15, v1.16 and main of August 2026; ModuleBase is not used, since its shape changed between them.
#pragma once

#include "Companion.hpp"
#include "Share.hpp"
#include "coax_vehicle.hpp"

#include <drivers/drv_hrt.h>
#include <lib/parameters/param.h>
#include <lib/perf/perf_counter.h>
#include <px4_platform_common/atomic.h>
#include <px4_platform_common/px4_work_queue/WorkItem.hpp>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/SubscriptionCallback.hpp>
#include <uORB/SubscriptionInterval.hpp>
#include <uORB/topics/actuator_motors.h>
#include <uORB/topics/control_allocator_status.h>
#include <uORB/topics/debug_array.h>
#include <uORB/topics/failure_detector_status.h>
#include <uORB/topics/mavlink_tunnel.h>
#include <uORB/topics/offboard_control_mode.h>
#include <uORB/topics/parameter_update.h>
#include <uORB/topics/vehicle_control_mode.h>
#include <uORB/topics/vehicle_thrust_setpoint.h>
#include <uORB/topics/vehicle_torque_setpoint.h>

class CoaxMixer : public px4::WorkItem
{
public:
	CoaxMixer();
	~CoaxMixer() override;

	bool init();          // false: this vehicle's parameters forbid it; it says which
	void request_stop();
	bool stopped() const { return _stopped.load(); }
	bool armed() const { return _armed; }
	void print_status();

private:
	static constexpr int BUDGET = 400;  // passes over the arms in one call, at most
	static constexpr hrt_abstime DEMAND_PERIOD_US = 3900;  // 250 Hz, a little early rather than a period late
	static constexpr hrt_abstime STATUS_PERIOD_US = 5000;  // as PX4's own allocator
	static constexpr uint32_t PARAMETERS_US = 100000;  // a trial that is taken back waits no longer
	static constexpr hrt_abstime SETPOINT_US = 300000;  // an offboard set-point that is older comes from nobody

	void Run() override;
	void read_parameters();
	void check_failures();
	void take_setpoints(const vehicle_torque_setpoint_s &torque);
	void take_answers(hrt_abstime now);
	void take_share(hrt_abstime now);
	void refuse_share();
	void publish_motors(hrt_abstime now, hrt_abstime sample);
	void publish_status(hrt_abstime now);
	void publish_demand(hrt_abstime now);

	uORB::SubscriptionCallbackWorkItem _torque_sub{this, ORB_ID(vehicle_torque_setpoint)};
	uORB::Subscription _thrust_sub{ORB_ID(vehicle_thrust_setpoint)};
	uORB::Subscription _mode_sub{ORB_ID(vehicle_control_mode)};
	uORB::Subscription _failure_sub{ORB_ID(failure_detector_status)};
	uORB::Subscription _tunnel_sub{ORB_ID(mavlink_tunnel)};
	uORB::Subscription _offboard_sub{ORB_ID(offboard_control_mode)};
	uORB::SubscriptionInterval _parameter_sub{ORB_ID(parameter_update), PARAMETERS_US};
	uORB::Publication<actuator_motors_s> _motors_pub{ORB_ID(actuator_motors)};
	uORB::Publication<control_allocator_status_s> _status_pub{ORB_ID(control_allocator_status)};
	uORB::Publication<debug_array_s> _demand_pub{ORB_ID(debug_array)};

	coaxlink::BoardLaw _law{
		coaxlink::NUMBERS<float>, coaxlink::NUMBERS<double>, BUDGET};
	coaxlink::Companion<coaxlink::ROTORS> _companion{coaxlink::IDENTITY};
	coaxlink::Share<coaxlink::SHARES> _share{coaxlink::SHARE, coaxlink::LEAN, coaxlink::OWN_SHARE};

	float _setpoint[4] {};              // roll, pitch, yaw, thrust (upward)
	float _speed[coaxlink::ROTORS] {};    // what is flown, of full speed
	float _command[coaxlink::ROTORS] {};  // what motors are told for it, 0..1
	float _curve{0.f};                  // THR_MDL_FAC
	bool _follow{true};                 // COAX_COMP
	bool _handle_failures{false};       // CA_FAILURE_MODE
	int32_t _system{1};                 // MAV_SYS_ID
	uint16_t _failed{0};                // motors taken out of the law
	bool _publish{false}, _armed{false}, _offboard{false};
	float _lean{0.f};
	orb_advert_t _talk{nullptr};
	hrt_abstime _last_run{0}, _last_demand{0}, _last_status{0};
	uint32_t _unsettled{0}, _fell_back{0}, _not_finite{0}, _told{0};
	int32_t _most_work{0};
	px4::atomic_bool _stop{false}, _stopped{false};
	perf_counter_t _cycle;
};
