"""What every solved stack can do: the contract of a BSDF, and the checks of its arguments.

Conventions: z is up; wi and wo are unit vectors that point away from the surface, on either side (z < 0 is the far
side). ``eval`` returns f |cos theta_o|; ``pdf`` is per solid angle; delta parts (smooth interfaces, unscattered light)
are 0 in both and occur in ``sample``. Numpy arrays give numpy arrays, Dr.Jit arrays give Dr.Jit arrays.
"""

from __future__ import annotations

import importlib
import pickle
import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from urushi import llvm, notebook
from urushi.errors import UrushiError
from urushi.stack import Stack

if TYPE_CHECKING:
    from .ledger import Ledger


@dataclass(frozen=True)
class Sample:
    """Sampled directions.

    Attributes:
        wo: (N, 3) directions.
        weight: (N, C) f |cos theta_o| / pdf; for a delta part, its energy over its probability.
        pdf: (N,) density per solid angle; for a delta part, its probability.
        delta: (N,) True where a delta part was taken.
    """

    wo: Any
    weight: Any
    pdf: Any
    delta: Any


class BSDF(ABC):
    """A solved stack. See the module docstring for conventions.

    It can be pickled and copied deeply: it is made again of its description and options, and of what was solved by
    adding, and has the same values; code is compiled and tables are made anew.

    Attributes:
        stack: the description.
        diagnostics: method, sizes and settings, and what else the solver has to say.
    """

    stack: Stack
    diagnostics: dict[str, Any]

    @abstractmethod
    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        """f |cos theta_o|: wi (N, 3), wo (N, 3) -> (N, C); with `with_error`, that and its standard error."""

    @abstractmethod
    def pdf(self, wi: Any, wo: Any) -> Any:
        """Density of `sample` per solid angle: (N, 3), (N, 3) -> (N,)."""

    @abstractmethod
    def sample(self, wi: Any, u: Any) -> Sample:
        """Sample wo: wi (N, 3), u (N, 3) in [0, 1)."""

    @abstractmethod
    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Directional-hemispherical reflectance, delta parts included: (N, 3) -> (N, C)."""

    @abstractmethod
    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Flux transmitted to the other side, delta parts included: (N, 3) -> (N, C)."""

    def absorption(self, wi: Any, *, with_error: bool = False) -> Ledger:
        """Where the light from numpy wi (N, 3) goes: reflected, transmitted, absorbed and lost in each layer.

        Args:
            wi: directions that light can come from: any but along the surface, above it if the stack is opaque.
            with_error: the entries' errors, too: standard errors of the walk, what a deterministic solver expects, and
                0 where nothing is known.

        Returns:
            A `urushi.solvers.ledger.Ledger`, whose entries add up to 1.

        Raises:
            UrushiError: this BSDF knows nothing of what is inside, or a direction that no light comes from.
        """
        raise UrushiError(f"absorption: a {type(self).__name__} knows nothing of what is inside the stack")

    def _repr_png_(self) -> bytes | None:
        """The lobe as a picture, for a notebook."""
        return notebook.picture(self)

    # --- copies --------------------------------------------------------------------------------------------------

    def _made_of(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments, without Dr.Jit arrays, that make another such BSDF.

        Raises:
            UrushiError: there are none, or derivatives would be lost.
        """
        raise UrushiError(
            f"a {type(self).__name__} can be neither pickled nor copied deeply; allowed: copy.copy"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # In bytes of their own, since to read them may import Dr.Jit, which `made_again` has to prepare first.
        arguments = pickle.dumps((*self._made_of(), dict(self.diagnostics)))
        return made_again, (type(self).__module__, type(self).__name__, arguments)

    def __copy__(self) -> BSDF:
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__)
        return found


def made_again(module: str, name: str, arguments: bytes) -> BSDF:
    """A BSDF of what was pickled of one, in a process that may be another.

    Args:
        module, name: its class.
        arguments: pickled: its arguments, those with names, and its diagnostics, of which the new one gets what it
            does not say itself.
    """
    if "drjit" not in sys.modules:
        llvm.prepare()  # before Dr.Jit takes the first LLVM it finds
    kind = getattr(importlib.import_module(module), name)
    parts, options, diagnostics = pickle.loads(arguments)
    found: BSDF = kind(*parts, **options)
    for key, value in diagnostics.items():
        found.diagnostics.setdefault(key, value)
    return found


def directions(value: Any, name: str) -> np.ndarray:
    """Unit directions as an (N, 3) float64 array.

    Raises:
        UrushiError: another shape, a value that is not finite, or a length that is not 1 within 1e-3.
    """
    array = _floats(value, name)
    if array.shape == (3,):
        array = array[None]
    if array.ndim != 2 or array.shape[1] != 3:
        raise UrushiError(f"{name}: found shape {array.shape}; allowed: (N, 3)")
    if not np.isfinite(array).all():
        raise UrushiError(f"{name}[{_first(~np.isfinite(array).all(1))}]: not finite; allowed: unit vectors")
    length = np.linalg.norm(array, axis=1)
    off = np.abs(length - 1) > 1e-3
    if off.any():
        i = _first(off)
        raise UrushiError(
            f"{name}[{i}]: found length {length[i]:.6g}; allowed: unit vectors (length 1 within 1e-3)"
        )
    return array / np.maximum(length, 1e-30)[:, None]


def random_numbers(value: Any, name: str = "u") -> np.ndarray:
    """Numbers in [0, 1) as an (N, 3) float64 array."""
    array = _floats(value, name)
    if array.shape == (3,):
        array = array[None]
    if array.ndim != 2 or array.shape[1] != 3:
        raise UrushiError(f"{name}: found shape {array.shape}; allowed: (N, 3)")
    wrong = ~((array >= 0) & (array < 1)).all(1)
    if wrong.any():
        raise UrushiError(
            f"{name}[{_first(wrong)}]: found {array[_first(wrong)]}; allowed: numbers in [0, 1)"
        )
    return array


def same_count(first: np.ndarray, second: np.ndarray, names: str) -> tuple[np.ndarray, np.ndarray]:
    """Both with as many rows; a single row serves all of the other."""
    n = len(first) if len(second) == 1 else len(second)
    if len(first) not in (1, n) or len(second) not in (1, n):
        raise UrushiError(
            f"{names}: found {len(first)} and {len(second)} rows; allowed: as many of each, or one"
        )
    return np.broadcast_to(first, (n, 3)), np.broadcast_to(second, (n, 3))


def _floats(value: Any, name: str) -> np.ndarray:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UrushiError(
            f"{name}: found {type(value).__name__}, not numbers; allowed: an array (N, 3)"
        ) from error


def _first(mask: Any) -> int:
    return int(np.argmax(mask))
