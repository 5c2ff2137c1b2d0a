"""Tasks of where the tool and the base are, and of the posture of all joints."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import PlanningError
from longreach.planning import _stack_kernels as kernels
from longreach.planning.task import Jacobian, Task, Value, in_fours, target_array
from longreach.reference import check_rigid
from longreach.robot.mobile_manipulator import MobileManipulator


@dataclass(frozen=True, eq=False, kw_only=True)
class _Common(Task):
    """A task of a kind that is compiled; `numbers` is its target."""

    kind: ClassVar[int]

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        T, J = robot.forward_and_jacobian(q)
        return self._at(robot, q, T, J)

    def _at(
        self, robot: MobileManipulator, q: Float[np.ndarray, " n"], T: np.ndarray, J: np.ndarray
    ) -> tuple[Value, Jacobian]:
        m = len(self.angular(robot))
        e, A, kinds, target = np.empty(m), np.zeros((m, robot.dof)), np.array([self.kind]), self.numbers()[None]
        q = np.array(q, dtype=float)
        kernels.errors(kinds, target, q, T, e)
        kernels.jacobians(kinds, target, q, T, J, e, A)
        return e, A


@dataclass(frozen=True, eq=False)
class _ToolTask(_Common):
    """Of a frame's pose; the tool's where no frame is named."""

    frame: str | None = field(default=None, kw_only=True)

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        at = robot.forward_and_jacobian(q) if self.frame is None else robot.frame_and_jacobian(self.frame, q)
        return self._at(robot, q, *at)


@dataclass(frozen=True, eq=False)
class ToolPose(_ToolTask):
    """e = log(T_target⁻¹ T) (6,) [m, rad] (4.28); target: T_world_tool (4, 4)."""

    target: Float[np.ndarray, "4 4"]
    name: str = field(default="tool pose", kw_only=True)
    kind: ClassVar[int] = kernels.TOOL_POSE

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (4, 4), self.name))
        check_rigid(self.target[None], f"The target of {self.name}")

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "6"]:
        return np.array([False] * 3 + [True] * 3)

    def numbers(self) -> Float[np.ndarray, "4 4"]:
        return self.target.copy()


@dataclass(frozen=True, eq=False)
class ToolPosition(_ToolTask):
    """e = p - p_target (3,) [m] in the world, (3.17) with its sign turned; target (3,)."""

    target: Float[np.ndarray, "3"]
    name: str = field(default="tool position", kw_only=True)
    kind: ClassVar[int] = kernels.TOOL_POSITION

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (3,), self.name))

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "3"]:
        return np.zeros(3, dtype=bool)

    def numbers(self) -> Float[np.ndarray, "4 4"]:
        T = np.eye(4)
        T[:3, 3] = self.target
        return T


@dataclass(frozen=True, eq=False)
class ToolOrientation(_ToolTask):
    """e = log(R_targetᵀ R) (3,) [rad]; target: R_world_tool (3, 3)."""

    target: Float[np.ndarray, "3 3"]
    name: str = field(default="tool orientation", kw_only=True)
    kind: ClassVar[int] = kernels.TOOL_ORIENTATION

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (3, 3), self.name))
        check_rigid(self.numbers()[None], f"The target of {self.name}")

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "3"]:
        return np.ones(3, dtype=bool)

    def numbers(self) -> Float[np.ndarray, "4 4"]:
        T = np.eye(4)
        T[:3, :3] = self.target
        return T


@dataclass(frozen=True, eq=False)
class _BaseTask(_Common):
    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        if robot.base.stop == 0:
            raise PlanningError(f"{robot.name} is bolted down and has no base that {self.name} could move.")
        return super().value_and_jacobian(robot, q)


@dataclass(frozen=True, eq=False)
class BasePose(_BaseTask):
    """e = log(target⁻¹ base) in SE(2) (3,) [m, m, rad]; target: [x, y, θ]."""

    target: Float[np.ndarray, "3"]
    name: str = field(default="base pose", kw_only=True)
    kind: ClassVar[int] = kernels.BASE_POSE

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (3,), self.name))

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "3"]:
        return np.array([False, False, True])

    def numbers(self) -> Float[np.ndarray, "1 4"]:
        return in_fours(self.target)


@dataclass(frozen=True, eq=False)
class BasePosition(_BaseTask):
    """e = [x, y] - target (2,) [m]."""

    target: Float[np.ndarray, "2"]
    name: str = field(default="base position", kw_only=True)
    kind: ClassVar[int] = kernels.BASE_POSITION

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (2,), self.name))

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "2"]:
        return np.zeros(2, dtype=bool)

    def numbers(self) -> Float[np.ndarray, "1 4"]:
        return in_fours(self.target)


@dataclass(frozen=True, eq=False)
class BaseHeading(_BaseTask):
    """e = θ - target (1,) [rad], the short way round."""

    target: float
    name: str = field(default="base heading", kw_only=True)
    kind: ClassVar[int] = kernels.BASE_HEADING

    def __post_init__(self) -> None:
        super().__post_init__()
        target_array(np.array(self.target), (), self.name)

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "1"]:
        return np.ones(1, dtype=bool)

    def numbers(self) -> Float[np.ndarray, "1 4"]:
        return in_fours(np.array([0.0, 0.0, self.target]))


@dataclass(frozen=True, eq=False)
class Posture(_Common):
    """e = q - target (n,) [rad, or m where prismatic]; `weights` of 0 leave joints free."""

    target: Float[np.ndarray, " n"]
    name: str = field(default="posture", kw_only=True)
    kind: ClassVar[int] = kernels.POSTURE

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (len(self.target),), self.name))

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, " n"]:
        if len(self.target) != robot.dof:
            raise PlanningError(f"The {self.name} has {len(self.target)} numbers, but {robot.name} has {robot.dof}.")
        return ~robot.prismatic

    def numbers(self) -> Float[np.ndarray, "_ 4"]:
        return in_fours(self.target)
