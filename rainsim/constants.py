"""Constants of physics and of the field, each once, with its source.

Formulas of kernels work in single precision: a number there is written as `np.float32(...)`, since
a bare float would turn the formula into double precision. The commonest have names here.
"""

import numpy as np

ZERO, ONE, TWO, THREE, FOUR = (np.float32(n) for n in range(5))
HALF, QUARTER = np.float32(0.5), np.float32(0.25)  # exact in every floating type
PI, HALF_PI = np.float32(np.pi), np.float32(np.pi / 2)

# Conventions of captured pictures.
FAR_AWAY = np.float32(1e4)  # m, stands for the depth of the sky and for heights off the map
SURFACE_ALPHA = np.float32(0.1)  # what covers less of a pixel is no surface and has no depth

GRAVITY = 9.81  # m/s2
WATER_DENSITY = 1000.0  # kg/m3; 998 at 20 C, which no use here tells apart
WATER_VISCOSITY = 1.0e-6  # m2/s, kinematic, at 20 C (IAPWS)
SURFACE_TENSION = 0.0728  # N/m, water against air at 20 C (IAPWS)
REFRACTIVE_INDEX = 1.333  # of water against air for visible light at 20 C (IAPWS)

# Factors of the real spherical harmonics, by degree, in the order and with the signs of the
# original 3DGS code (Kerbl et al. 2023). SH_0 = 1 / (2 sqrt(pi)); a splat's colour of degree 0 is
# SH_0 sh[0] + 1/2.
SH_0 = 0.28209479177387814
SH_1 = 0.4886025119029199
SH_2 = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
SH_3 = (
    0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154,
    1.445305721320277,
)  # fmt: skip
