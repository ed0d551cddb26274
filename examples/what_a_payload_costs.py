"""How does a payload that the controller does not know reduce the margins?

A UR5 under computed torque moves along a path with 0 to 6 kg at its tool. The script prints the smallest margins along the path, the sag at rest
without an integral, and the largest stable payload.
"""

import numpy as np

import mfc_analysis as mfc

arm = mfc.robots.ur5()
q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])  # rad
path = mfc.trajectories.Sinusoid(center=q0, amplitude=0.4, frequency=2.0)  # rad, rad/s
times = np.linspace(0.0, path.period, 17)
gains = mfc.gains.pid(bandwidth=mfc.hertz(8), damping=1.0)
drives = mfc.Hardware(torque_lag=2e-3)  # s


def loop(payload, law, ref):
    return mfc.ClosedLoop(arm.with_payload(payload), law, ref, controller_model=arm, hardware=drives)


print("payload   phase margin                            delay margin   Ms     sag without integral")
for payload in (0.0, 2.0, 4.0, 6.0):
    worst = loop(payload, mfc.laws.ComputedTorque(**gains), path).linearize(times).margins().worst()
    angle, t, joint = worst.phase_deg
    pd = mfc.laws.ComputedTorque(kp=gains.kp, kd=gains.kd)
    sag = np.degrees(np.abs(loop(payload, pd, mfc.trajectories.Hold(q0)).equilibrium().error).max())
    print(
        f"{payload:4.0f} kg   {angle:5.1f} deg ({joint}, t = {t:4.2f} s)".ljust(50)
        + f"{1e3 * worst.delay[0]:5.1f} ms   {worst.sensitivity_peak[0]:9.2f}   {sag:6.2f} deg"
    )

print(mfc.design.max_payload(loop(0.0, mfc.laws.ComputedTorque(**gains), mfc.trajectories.Hold(q0))))
