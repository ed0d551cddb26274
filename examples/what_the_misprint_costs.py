"""What happens if a misprinted equation is implemented as printed?

Four laws have a misprint in their equation. The script runs both forms of each law on the same robot, and prints the rightmost pole and the tracking
error in a simulation that starts with the integral at 0.
"""

import numpy as np

import mfc_analysis as mfc

arm = mfc.robots.ur5()
q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])  # rad
X0 = arm.pose(q0)
joints = mfc.trajectories.Sinusoid(center=q0, amplitude=0.4, frequency=2.0)  # rad, rad/s
tool = mfc.trajectories.ToolSinusoid(X0, amplitude=[0.0, 0.05, 0.0], frequency=3.0, axis=(0, 0, 1), angle=0.4)  # m, rad/s, rad
pid = mfc.gains.pid(natural_frequency=5.0, damping=1.0)

cases = [
    ("9.3  no Ki on the integral", mfc.laws.VelocityPI, {"kp": 8.0, "ki": 16.0}, joints, None),
    ("9.5  X_e = X_d - X", mfc.laws.TaskVelocity, {"kp": 4.0}, tool, q0),
    ("9.10 h at (q_d, v_d)", mfc.laws.ComputedTorque, dict(pid), joints, None),
    ("9.16 V_d' and X_e'", mfc.laws.TaskComputedTorque, dict(pid), tool, q0),
]
print("law and misprint                form        rightmost pole    tracking error after 2 s")
for name, law, gains, ref, q_start in cases:
    for form in ("standard", "printed"):
        loop = mfc.ClosedLoop(arm, law(**gains, form=form), ref, q_start=q_start)
        rightmost = loop.linearize(np.linspace(0.0, ref.period, 9)).poles().real.max()
        run = loop.simulate(np.linspace(0.0, 6.0, 301), initial_error=0.05)
        error = np.abs(run.error[run.t > 2.0]).max(axis=0)
        worst = int(error.argmax())
        unit = "m" if ref.space == "tool" and worst < 3 else "rad"
        print(f"{name:31s} {form:9s} {rightmost:11.2f} 1/s {error[worst]:17.5f} {unit}" + ("   DIVERGED" if run.diverged else ""))
