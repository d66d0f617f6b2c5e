"""Write src/urushi/optics/data/conductors.csv: the RGB index of every conductor, as Mitsuba itself computes it.

Run it with Mitsuba installed, and again when Mitsuba changes its tables:

    python tools/make_conductor_table.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HEADER = """\
# Complex index (eta - i k, absolute) of conductors in linear sRGB: what the BSDF "roughconductor" of Mitsuba {version}
# uses for material=NAME in an RGB variant, read back with mitsuba.traverse. Written by tools/make_conductor_table.py.
# Spectral sources, as named in Mitsuba's own files: the SOPRA / luxpop database; *_palik: Palik, Handbook of Optical
# Constants of Solids. "none" is a perfect mirror. Nine digits: the exact single-precision values.
"""


def main() -> None:
    """Ask Mitsuba for every conductor and write the table."""
    from urushi.llvm import ensure

    ensure()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(
        mi.LogLevel.Error
    )  # it warns of channels that it clamps; the docstring of ior.py says so
    folder = Path(mi.__file__).parent / "data" / "ior"
    names = sorted(path.name.removesuffix(".eta.spd") for path in folder.glob("*.eta.spd"))
    rows = ["name,eta_r,eta_g,eta_b,k_r,k_g,k_b"]
    for name in sorted([*names, "none"]):
        values = mi.traverse(mi.load_dict({"type": "roughconductor", "material": name}))
        numbers = [np.broadcast_to(np.ravel(np.array(values[key])), 3) for key in ("eta.value", "k.value")]
        rows.append(",".join([name, *(f"{number:.9g}" for number in np.concatenate(numbers))]))
    path = Path(__file__).parents[1] / "src" / "urushi" / "optics" / "data" / "conductors.csv"
    path.parent.mkdir(exist_ok=True)
    path.write_text(HEADER.format(version=mi.__version__) + "\n".join(rows) + "\n", encoding="utf-8")
    print(f"{len(rows) - 1} conductors -> {path}")


if __name__ == "__main__":
    main()
