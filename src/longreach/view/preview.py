"""The way of a plan before and while it runs: the paths of base and tool, and where the base will stand."""

from typing import Any

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.view import bodies
from longreach.view.scene import COLOURS, Scene, rgb

_ROWS = 300  # of a plan that are drawn
_BELOW = np.array([0.0, 0.0, -0.006])  # what is driven [m], so that both are seen


class Preview:
    """Nodes of at most one plan."""

    def __init__(self, scene: Scene, server: Any, robot: MobileManipulator) -> None:
        self._scene, self._robot, self._paths = scene, robot, []
        self._goal = bodies.add_base_outline(server.scene, "/goal", robot, rgb(COLOURS["base planned"]), 0.03)

    def show(self, plan: ConfigurationTrajectory) -> None:
        """Draw a plan, and nothing of the one before."""
        self.hide()
        rows = np.unique(np.linspace(0, len(plan) - 1, _ROWS).astype(int))
        q = plan.q[rows]
        if self._robot.base.stop:
            way = np.column_stack([q[:, :2], np.zeros(len(q))])
            self._paths.append(self._scene.add_path("plan/base", way + _BELOW, COLOURS["base planned"], 4.0))
            bodies.place_plane(self._goal, q[-1, :3])
            self._goal.visible = True
        tool = self._robot.forward(q)[:, :3, 3]
        self._paths.append(self._scene.add_path("plan/tool", tool + _BELOW, COLOURS["tool planned"], 4.0))

    def hide(self) -> None:
        """Take it away."""
        for node in self._paths:
            node.remove()
        self._paths, self._goal.visible = [], False
