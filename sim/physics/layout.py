"""Where the compiled plant keeps its numbers: state, parameters, geometry, outputs, scratch."""

# state: rigid body first, then the pack, then what each rotor has
POS, VEL, QUAT, RATE = 0, 3, 6, 10
CHARGE, VOLTAGE, CURRENT, RELAXED, SPEED = 13, 14, 15, 16, 18
# each rotor: normalised speed; what it follows where a lag is of second order; winding over air (K);
# flow that blades induce (m/s), and in a lower rotor's outer ring
PER_ROTOR = 5

# parameters; a _LAW counts as `effects.FORMS` lists them
# fmt: off
(
    MASS, IXX, IYY, IZZ, GRAVITY, GROUND_Z, LAG, TOP_RATE, TIP_SPEED, CX, CY, CZ, GROUND_GAIN, GROUND_SCALE,
    INFLOW, DRAG, ROTOR_INERTIA, BODY_DRAG, WIND, _WIND_E, _WIND_D, VOLT_POWER, VOLT_REF, CELLS, CAPACITY,
    RESISTANCE, EFFICIENCY, FOOT_XY, FOOT_Z, GROUND_LAW, INFLOW_HOVER, INFLOW_LIFT, DRAG_LAW, DRAG_SCALE,
    LAG_LAW, LAG_RATIO, VOLT_LAW, VOLT_SHARE, PACK_LAW, BODY_LINEAR, AIR, CEILING_Z, CEILING_GAIN,
    CEILING_LAW, RADIUS, HEAT_SHARE, HEAT_LAW, MOTOR_KT, WINDING, HEAT_CAPACITY, COOLING, PUSH, _PUSH_Y,
    _PUSH_Z, PARAMETERS,
) = range(55)
# fmt: on

# geometry, a row a quantity and a column a rotor
G_POS, G_AXIS, G_SPIN, G_THRUST, G_TORQUE, G_SPEED = 0, 3, 6, 7, 8, 9
GEOMETRY = 10

# outputs at the end of a step: specific force, angular acceleration, thrust (N), torque (N)
O_FORCE, O_ALPHA, O_THRUST = 0, 3, 6

# scratch, a row a quantity and a column a rotor: speeds at the start of a step and within it; STILL: thrust
# and torque in still air, of blades lift slope and profile drag; PULL: drag along the disc, N s/m
(
    W_U, W_LED, W_TARGET, W_HEAT, W_U0, W_LED0, W_STILL, W_STILL_Q, W_THRUST, W_TORQUE, W_PULL, W_ROWS,
) = range(12)  # fmt: skip
# induced flows: the upper disc or a lower rotor's inner ring, a lower rotor's outer ring; in each of these
# at the start of a step, within it, their slopes, and the sum of these over a step
F_INNER, F_OUTER = 0, 1
F_START, F_NOW, F_SLOPE, F_SUM, F_ROWS = 0, 2, 4, 6, 8

TABLES = 8  # of a pair: loads, speeds, watts; eq. 17 has no such power
REACH = 1.25  # how far tables go, of full speed or command: a full pack is 1.15 of the usual voltage
SOUND_M_S = 340.0
SLOWEST = 0.15  # below this share of full speed the Reynolds number's power law is not trusted
FASTEST = 1.2
