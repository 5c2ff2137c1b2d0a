"""Base and arm as one chain: where the hand is, how each joint moves it, and which joints put it elsewhere.

python examples/03_kinematics.py
"""

import numpy as np

import longreach as lr

thing = lr.load_robot("thing")
print(f"{thing.name}: {', '.join(thing.joint_names)}")

q = np.array([1.0, 2.0, 0.3, 0.0, -1.5, 1.2, -0.5, -1.57, 0.0])  # x, y, θ of the base, then the arm
T_world_tool, J = thing.forward_and_jacobian(q)
print("the tool is at", np.round(T_world_tool[:3, 3], 4), "m")

half_a_degree = np.zeros(thing.dof)
half_a_degree[thing.base.stop - 1] = np.radians(0.5)
print(f"half a degree of base heading moves it {1e3 * np.linalg.norm((J @ half_a_degree)[:3]):.1f} mm")

flange = thing.with_tool("flange")
print("the flange is at", np.round(flange.forward(q)[:3, 3], 4), "m")

target = T_world_tool.copy()
target[2, 3] += 0.2  # 20 cm higher
solution = lr.solve_ik(thing, target, q)
print(solution.status, f"(left: {solution.residuals['position']:.1e} m)")
print("q =", np.round(solution.q, 3))
