"""Why does the arm hold its force on rubber and chatter on steel, with the same gains?

The stability of an ideal force loop (9.23) does not depend on the stiffness. With a torque lag there is a largest stable stiffness, which has a
closed form for one mass. The script compares a one-mass loop with this closed form, and then analyses and simulates the UR5 on rubber and on steel.
"""

import numpy as np

import mfc_analysis as mfc

sensed = np.array([0, 0, 1, 0, 0, 0])
F_d = 10.0 * sensed  # N, along z of the tool

# one mass m on a spring, with torque lag T: stable below [kdamp (1 + kfp) - m kfi] / [T kfp (1 + kfp)]
m, kfp, kfi, kdamp, T = 2.0, 0.5, 3.0, 30.0, 2e-3
law = mfc.laws.DampedForcePI(F_d, kfp=kfp * sensed, kfi=kfi * sensed, kdamp=kdamp * sensed)
for lag in (None, T):
    loop = mfc.ClosedLoop(
        mfc.robots.slider(mass=m),
        law,
        mfc.trajectories.Hold([0.0]),
        environment=mfc.Environment(1e3, preload=10.0),
        hardware=mfc.Hardware(torque_lag=lag),
    )
    print(f"one mass, lag {0 if lag is None else 1e3 * lag:.0f} ms: stable up to {float(mfc.design.max_stiffness(loop)):.0f} N/m")
print(f"closed form: {(kdamp * (1 + kfp) - m * kfi) / (T * kfp * (1 + kfp)):.0f} N/m\n")

# the arm presses along z on the surface; a foot that sticks to it holds the other directions
arm = mfc.robots.ur5()
q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])
law = mfc.laws.DampedForcePI(F_d, kfp=1.5 * sensed, kfi=3.0 * sensed, kdamp=[60, 60, 60, 1, 1, 1])
foot = mfc.Environment([5e3, 5e3, 50, 50, 50], axes="xyrxryrz")  # N/m, Nm/rad
drives = mfc.Hardware(torque_lag=4e-3, force_filter=2e-3)  # s
for name, stiffness in (("rubber", 1e4), ("steel", 1e5)):
    surface = mfc.Environment(stiffness, damping=20.0, preload=10.0, one_sided=True)
    loop = mfc.ClosedLoop(arm, law, mfc.trajectories.Hold(q0), environment=[surface, foot], hardware=drives)
    stable = loop.linearize().stable[0]
    run = loop.simulate(np.linspace(0.0, 0.5, 251), q=q0 + 1e-4)
    swing = np.ptp(run.force[run.t > 0.4, 2])
    lifts = sum(event.kind == "lift" for event in run.events)
    verdict = "stable" if stable else "unstable"
    print(f"{name:6s} {stiffness:.0e} N/m: {verdict}; in simulation the force oscillates by {swing:.2g} N, and contact is lost {lifts} times")
print(f"\nThe arm with these drives is stable up to {float(mfc.design.max_stiffness(loop)):.0f} N/m.")
