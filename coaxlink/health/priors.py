"""What a sound vehicle may be off by, and what a fault takes: for flights on disk and in the air alike.

A room of its own because live mixing and the monitor need these numbers and nothing that judges flights.
"""

LOSS_SD = 0.2  # of a fault's thrust: anything from a chip to half a blade
TORQUE_WITH_THRUST, TORQUE_APART = 0.85, 0.05  # chipped 0.6, shortened 1.25 of the thrust's loss
# of a rough blade's torque (ice, erosion, a nicked edge), gained with a deviation of lost thrust and apart
# from that: profile drag is 0.4 of it in hover (figure of merit 0.6), and standard roughness adds a half
# (Abbott and von Doenhoff 1959, section 7.4)
ROUGH_TORQUE = 0.2
DISTURBED = 0.05  # of weight, and weight x arm: sd of a sudden disturbance
WATCH, GROUND = 0.05, 0.5  # probabilities that a rotor lost more than MATTERS
MATTERS = 0.05  # of thrust: less is within a propeller's own scatter and trim
TILT_ARM_M = 8e-4  # of lift: eight motors each up to half a degree askew on 0.26 m arms
CG_DRAWN_M, CG_MOVED_M = 5e-3, 3e-3  # drawn against weighed; a pack strapped back on
INERTIA_TODAY, DELAY_TODAY_S = 0.01, 0.01  # motors are slower on a weak pack
LIFT_TODAY, TORQUE_TODAY = 0.10, 0.05  # of all rotors alike: voltage, air density, mass
MENDED = 0.5  # of rotors that lost something, those that are changed before the last flight (judgement)
