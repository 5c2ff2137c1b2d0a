"""What every chain of joints can compute: poses, Jacobians and Hessians, one configuration or many.

The Jacobian is the geometric one, (3.12)-(3.15): its columns are [v; ω], the velocity of the point at the chain's end
and the angular velocity of the end, both in the root's axes, for a unit speed of the joint. Algorithm 1 sets z = 0 for
a prismatic joint and then uses it: right is v = z, ω = 0.
"""

from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from numba import types

from longreach.errors import ModelError
from longreach.robot import _kinematics_kernels as kernels

_empty, _POSE = np.empty, (4, 4)


def _later(*_: object) -> bool:
    """Stand in for the kernel until `_compile`."""
    raise TypeError


_checked = _later


@cache
def _compile() -> None:
    """Compile the kernel for arrays in C order, a q that is writeable or read-only, and for nothing else.

    So an argument of another type raises TypeError, and is looked at, instead of starting the compiler.
    """
    global _checked
    f8 = types.float64
    for q in (types.Array(f8, 1, "C"), types.Array(f8, 1, "C", readonly=True)):
        kernels.checked.compile((f8[:, :, ::1], q, f8[:, ::1], f8[:, ::1]))
    kernels.checked.disable_compile()
    _checked = kernels.checked


class Kinematics:
    """Pose, Jacobian and Hessian of the end of a chain T = F[0] · J_0(q_0) · F[1] ⋯ F[k], each J_i along or about z."""

    _fixed: np.ndarray  # (k + 1, 4, 4), k ≤ n: joints after the k-th do not move the end
    _prismatic: np.ndarray  # (n,)
    _model: np.ndarray  # both in one, for the kernel `checked`
    _shape: tuple[int, int]  # (6, n)

    def _hold(self, fixed: np.ndarray, prismatic: np.ndarray) -> None:
        # Copies of our own that stay writeable, for numba is slower with read-only arguments.
        n, k = len(prismatic), len(fixed) - 1
        model = np.array(fixed, dtype=float)
        model[:k, 3, 0], model[k, 3, 0] = prismatic[:k], n
        object.__setattr__(self, "_fixed", np.array(fixed, dtype=float))
        object.__setattr__(self, "_prismatic", np.array(prismatic, dtype=bool))
        object.__setattr__(self, "_model", model)
        object.__setattr__(self, "_shape", (6, n))

    @property
    def dof(self) -> int:
        """How many numbers q has."""
        return self._shape[1]

    @property
    def fixed(self) -> Float[np.ndarray, "_ 4 4"]:
        """The transforms F (k + 1, 4, 4) between the joints that move the end, k ≤ n; a copy."""
        return self._fixed.copy()

    @property
    def prismatic(self) -> Bool[np.ndarray, " _"]:
        """Which joints (n,) slide; a copy."""
        return self._prismatic.copy()

    def forward(self, q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch 4 4"]:
        """Return the pose of the end, T_root_end, at one configuration or at many [rad or m]; (3.8).

        Raises:
            ModelError: q has the wrong length or a number that is not finite.
        """
        if np.ndim(q) == 1:
            return self.forward_and_jacobian(q)[0]
        Q = self._rows(q)
        T = np.empty((len(Q), 4, 4))
        kernels.forward_batch(self._fixed, self._prismatic, Q, T)
        return T.reshape(*np.shape(q)[:-1], 4, 4)

    def forward_and_jacobian(
        self, q: Float[np.ndarray, " n"], out: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 n"]]:
        """Return T_root_end (4, 4) and the Jacobian (6, n), in `out` = (T, J) where that is given.

        Raises:
            ModelError: q has the wrong length or a number that is not finite, or `out` is not two float arrays of
                these shapes, in C order.
        """
        if out is None:
            T, J = out = _empty(_POSE), _empty(self._shape)
        else:
            T, J = out
        try:
            if _checked(self._model, q, T, J):
                return out
        except TypeError:  # the first call, or an argument of a type that is looked at now
            pass
        return self._carefully(q, T, J)

    def forward_and_jacobian_batch(
        self, Q: Float[np.ndarray, "m n"]
    ) -> tuple[Float[np.ndarray, "m 4 4"], Float[np.ndarray, "m 6 n"]]:
        """Return T_root_end (m, 4, 4) and the Jacobian (m, 6, n) at each row of Q."""
        Q = self._rows(Q)
        T, J = np.empty((len(Q), 4, 4)), np.empty((len(Q), *self._shape))
        kernels.forward_jacobian_batch(self._fixed, self._prismatic, Q, T, J)
        return T, J

    def hessian(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 6 n"]:
        """Return the kinematic Hessian H (n, 6, n), H[k] = ∂J/∂q_k."""
        _, J = self.forward_and_jacobian(q)
        H = np.empty((self.dof, *self._shape))
        kernels.hessian(J, H)
        return H

    def _rows(self, q: np.ndarray) -> np.ndarray:
        """Return q as rows (m, n) of finite floats in C order, or say what is wrong with it."""
        try:
            rows = np.ascontiguousarray(q, dtype=float)
        except (TypeError, ValueError) as error:
            raise ModelError(f"A configuration must be {self.dof} numbers, but is {q!r}.") from error
        if rows.ndim == 0 or rows.shape[-1] != self.dof:
            raise ModelError(f"A configuration has {self.dof} numbers here, but q has the shape {np.shape(q)}.")
        if not np.all(np.isfinite(rows)):
            raise ModelError("A configuration must be finite, but q has NaN or infinity in it.")
        return rows.reshape(-1, self.dof)

    def _carefully(self, q: np.ndarray, T: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Do `forward_and_jacobian` for arguments of any type, or say what is wrong with them."""
        rows = self._rows(q)
        if len(rows) != 1:
            raise ModelError(f"One configuration is expected, but q has the shape {np.shape(q)}; use the batch.")
        for name, array, shape in (("T", T, _POSE), ("J", J, self._shape)):
            fits = type(array) is np.ndarray and array.shape == shape and array.dtype == np.float64
            if not (fits and array.flags.carray):
                raise ModelError(f"out's {name} must be a writeable array of floats in C order, of the shape {shape}.")
        _compile()
        _checked(self._model, rows[0], T, J)
        return T, J
