"""Which Mitsuba variant a command runs in."""

from __future__ import annotations

from urushi import llvm
from urushi.cli.common import WrongUsage
from urushi.errors import UrushiError


def use(variant: str | None = None) -> str:
    """Set the Mitsuba variant, after LLVM has been settled, and return its name.

    Args:
        variant: one of Mitsuba's, but not a scalar one: Urushi evaluates whole arrays. None means `llvm_ad_rgb`,
            or `cuda_ad_rgb` where there is a GPU but no LLVM.

    Raises:
        WrongUsage: there is no such variant.
        UrushiError: what the variant needs is missing.
    """
    problem: UrushiError | None = None
    try:
        llvm.ensure()
    except UrushiError as error:
        problem = error
    import drjit as dr
    import mitsuba as mi

    able = [known for known in mi.variants() if not known.startswith("scalar")]
    if variant is not None and variant not in able:
        raise WrongUsage(f"--variant is {variant!r}; allowed: {', '.join(able)}")
    cuda = dr.has_backend(dr.JitBackend.CUDA)
    chosen = variant or ("cuda_ad_rgb" if problem and cuda else "llvm_ad_rgb")
    if chosen.startswith("llvm") and problem:
        raise problem
    if chosen.startswith("cuda") and not cuda:
        raise UrushiError(f"variant {chosen} needs an NVIDIA GPU and its driver, and Dr.Jit finds none")
    mi.set_variant(chosen)
    from urushi.adapters import picture

    picture.enough_threads()  # a scene file may name an environment map in OpenEXR
    return chosen
