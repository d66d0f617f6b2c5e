"""Urushi in Mitsuba 3: the plugin `layered` (`plugin`), and how its layers get their numbers.

nested    Mitsuba's own BSDFs and media, given as children, read as layers
surface   the value of every parameter at a surface point: constants, textures, spectra
plugin    the BSDF
"""
