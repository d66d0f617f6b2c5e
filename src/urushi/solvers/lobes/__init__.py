"""Lobes: a stack as a handful of lobes, in closed form.

What a layer does to light is put into a few numbers: how much energy, around which direction, how wide. Each atomic event
(reflection, refraction, absorption, scattering, becoming diffuse) is an operator on these, and the adding equations put
layers together, lobe after lobe. The answer is an approximation that costs about as much as one layer, for any number of
lights, with derivatives in every parameter.

    width      alpha <-> a width that adds up           operators   what an interface does to energy, direction, width
    tables     energies of rough interfaces             medium      the same for a slab of particles
    spread     widths through a stack                   flow        energies of a beam and of diffuse light at once
    recursion  all of it, lobe after lobe

Sources: Belcour 2018; Weier & Belcour 2020 (anisotropy); de Dinechin & Belcour 2022 (diffuse bases).
"""
