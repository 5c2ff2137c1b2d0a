"""Estimate where a base went, from its wheels, its LIDAR and its IMU, and compare with the truth.

python examples/01_estimate_a_recording.py
"""

import longreach as lr

thing = lr.load_robot("thing")
recording = lr.make_recording(thing, seed=1, duration=10.0, beams=361)  # yours: lr.read_recording("drive.mcap", thing)
print(f"{len(recording.wheels)} wheel records, {len(recording.scans)} scans, {len(recording.imu)} IMU readings")

result = lr.estimate(recording, thing)

for name, trajectory in result.trajectories.items():
    x, y, theta = trajectory.poses[-1]
    print(f"{name:7} ends at x {x:6.3f} m, y {y:6.3f} m, θ {theta:6.3f} rad")

for name, metrics in result.metrics.items():
    print(f"{name:7} position error {metrics['ate_rmse']['value']:.4f} {metrics['ate_rmse']['unit']} RMS")

for remark in result.remarks:
    print("note:", remark)
