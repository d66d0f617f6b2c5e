"""Urushi in Mitsuba 3: the plugins `layered` (`plugin`) and `fourier`, and how layers get their numbers.

nested    Mitsuba's own BSDFs and media, given as children, read as layers
surface   the value of every parameter at a surface point: constants, textures, spectra
plugin    the BSDF
fourier   a BSDF from a Fourier file
"""
