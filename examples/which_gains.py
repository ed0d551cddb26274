"""Which gains give this arm a bandwidth of 8 Hz, and which margins do they achieve?

The script computes gains from a bandwidth, first for a unit inertia (computed torque compensates the dynamics of the arm), then for each joint of the
arm separately (independent joints). It then uses both on the coupled arm, with a lag of 2 ms in the drives.
"""

import numpy as np

import mfc_analysis as mfc

arm = mfc.robots.ur5()
q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])  # rad
hold = mfc.trajectories.Hold(q0)
drives = mfc.Hardware(torque_lag=2e-3)  # s

central = mfc.gains.pid(bandwidth=mfc.hertz(8), damping=1.0)
print("Computed torque (9.10), for all joints:")
print(central)

independent = mfc.gains.joint_pid(arm, q0, bandwidth=mfc.hertz(8), damping=1.0)
print("\nIndependent joints (9.8):")
for name, kp, ki, kd in zip(arm.joint_names, independent.kp, independent.ki, independent.kd, strict=True):
    print(f"  {name:20s} kp {kp:8.1f} Nm/rad   ki {ki:9.1f} Nm/(rad s)   kd {kd:7.2f} Nm s/rad")

print("\nOn the coupled arm:")
for law in (mfc.laws.ComputedTorque(**central), mfc.laws.JointPID(**independent)):
    lin = mfc.ClosedLoop(arm, law, hold, hardware=drives).linearize()
    worst = lin.margins().worst()
    print(
        f"  eq. {law.equation:5s} slowest pole {lin.poles()[0].real.max():6.2f} 1/s, "
        f"phase margin {worst.phase_deg[0]:.1f} deg ({worst.phase_deg[2]}), delay margin {1e3 * worst.delay[0]:.1f} ms ({worst.delay[2]})"
    )
