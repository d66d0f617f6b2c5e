"""The physics of one piece: Fresnel's equations, microfacets, phase functions, refractive indices.

Everything here is a formula on Dr.Jit arrays (or on plain Python floats) of any precision and backend; nothing
here knows about stacks or solvers. Directions are unit vectors that point away from the surface, z is up.
"""
