"""How slow may the bus be? The lowest stable sample rate, and the margins at several rates.

The controller runs once a sample, and its torque is held between samples. The sampled model is exact; the rule of thumb (half a sample of dead time)
is not. A nonlinear simulation on both sides of the limit confirms the result.
"""

import numpy as np

import mfc_analysis as mfc

arm = mfc.robots.ur5().with_payload(2.0)
q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])  # rad
law = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(8), damping=1.0))


def sampled(period):
    hardware = mfc.Hardware(torque_lag=2e-3, sample_time=period)
    return mfc.ClosedLoop(arm, law, mfc.trajectories.Hold(q0), hardware=hardware)


ideal = mfc.ClosedLoop(arm, law, mfc.trajectories.Hold(q0), hardware=mfc.Hardware(torque_lag=2e-3))
limit = mfc.design.min_sample_rate(ideal)
rule = 1 / (2 * ideal.linearize().margins().worst().delay[0])
print(limit)
print(f"rule of thumb (half a sample of dead time): {rule:.1f} Hz\n")

for rate in (1000.0, 500.0, 250.0, 125.0, 62.5):
    worst = sampled(1 / rate).linearize().margins().worst()
    print(f"{rate:6.1f} Hz: phase margin {worst.phase_deg[0]:5.1f} deg, gain up to {worst.gain_increase[0]:5.2f}, Ms {worst.sensitivity_peak[0]:.2f}")

print()
for part in (1.05, 0.95):
    run = sampled(1 / (part * float(limit))).simulate(4.0, initial_error=1e-3, integral="trimmed")
    late = np.abs(run.error[run.t > 0.75 * run.end]).max()
    print(f"{part * float(limit):6.1f} Hz: an initial error of 1 mrad becomes {1e3 * late:.3g} mrad in the last quarter of {run.end:.1f} s")
