"""Can the arm press with 10 N while it slides along a wall?

Hybrid motion/force control (9.24), with a lag of the drives and a filtered force sensor. The script computes the margins of both loops and runs a
nonlinear simulation in which contact can be lost, first without a payload and then with a payload of 1 kg that the controller does not know.
"""

import numpy as np

import mfc_analysis as mfc

arm = mfc.robots.ur5()
q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])  # rad
X0 = arm.pose(q0)
along = X0[:3, 0]  # x of the tool, in the world
path = mfc.trajectories.ToolSinusoid(X0, amplitude=0.08 * along, frequency=2.0)  # m, rad/s
wall = mfc.Environment(stiffness=2e4, damping=50.0, axes="z", preload=10.0, one_sided=True)  # N/m, Ns/m, N; the wall pushes but does not pull
law = mfc.laws.HybridMotionForce(
    F_d=[0, 0, 10.0, 0, 0, 0], kp=100.0, kd=20.0, kfp=0.5, kfi=4.0, kdamp=150.0, constraints=[[0, 0, 1, 0, 0, 0]]
)  # N; 1/s^2, 1/s, -, 1/s, Ns/m; the wall stops the tool's z
drives = mfc.Hardware(torque_lag=2e-3, force_filter=2e-3)  # s

for payload in (0.0, 1.0):
    loop = mfc.ClosedLoop(arm.with_payload(payload), law, path, controller_model=arm, environment=wall, q_start=q0, hardware=drives)
    lin = loop.linearize(np.linspace(0.0, path.period, 9))
    force, motion = lin.margins(at="force"), lin.margins(at="command").worst()
    print(f"unknown payload {payload:.0f} kg: stable at {lin.stable.sum()} of {len(lin)} times")
    print(f"  force loop: phase margin {np.nanmin(force.phase_deg[:, 2]):.1f} deg, gain up to {np.nanmin(force.gain_increase[:, 2]):.1f}")
    print(f"  motion loop: phase margin {motion.phase_deg[0]:.1f} deg ({motion.phase_deg[2]})")
    run = loop.simulate(np.linspace(0.0, 6.0, 601))
    late = run.t > 3.0
    pressed, off = run.force[late, 2], 1e3 * np.abs(run.error[late, 0]).max()
    lifts = sum(event.kind == "lift" for event in run.events)
    print(f"  in simulation: {pressed.min():.2f} to {pressed.max():.2f} N, at most {off:.2f} mm from the line, contact lost {lifts} times\n")
