"""Recorded figures of other programs: points of the charts of water and of splatting.

Hydraulics codes on the cases of `benchmarks water`, run by examples/peers on 2026-11-27: ANUGA
4.1.0, PyClaw 5.14.0 with GeoClaw's solver, Landlab 2.11.0 and Itzi 25.8, on two shared cores of a
server processor, one thread. Seconds are of processor time, the least of two runs, errors relative
L1, as in the bench. Cases that a code did not finish are left out, and so is rain on a slope, whose
friction the codes define in other ways. The table of docs/compared.md has the finest sizes.
"""

SECONDS_AND_ERRORS = {  # by case and code: seconds and error, coarse grids first
    "stoker": {
        "ANUGA DE1": [(0.07, 0.0036), (0.276, 0.0018), (1.064, 0.0011)],
        "ANUGA DE0": [(0.038, 0.0059), (0.155, 0.0032), (0.58, 0.0019)],
        "PyClaw": [(0.005, 0.011), (0.016, 0.0069), (0.058, 0.0031)],
        "Landlab": [(0.004, 0.059), (0.009, 0.0607), (0.023, 0.062)],
        "Itzi": [(0.001, 0.0679), (0.004, 0.0635), (0.008, 0.0596)],
    },
    "ritter": {
        "ANUGA DE1": [(0.072, 0.0055), (0.296, 0.0032), (1.294, 0.0026)],
        "ANUGA DE0": [(0.043, 0.0086), (0.163, 0.0048), (0.723, 0.0027)],
        "PyClaw": [(0.005, 0.0198), (0.015, 0.0107), (0.059, 0.0065)],
        "Landlab": [(0.004, 0.1043), (0.009, 0.1034), (0.02, 0.1032)],
        "Itzi": [(0.001, 0.1265), (0.002, 0.1149), (0.007, 0.1092)],
    },
    "bowl planar": {
        "ANUGA DE1": [(2.196, 0.0314), (16.437, 0.0154)],
        "ANUGA DE0": [(1.1, 0.0602), (10.199, 0.03)],
        "Landlab": [(0.036, 0.8667), (0.17, 0.9567)],
        "Itzi": [(0.016, 1.3538), (0.091, 1.5406)],
    },
    "bowl radial": {
        "ANUGA DE1": [(0.532, 0.0218), (4.326, 0.0068)],
        "ANUGA DE0": [(0.31, 0.0261), (2.45, 0.0108)],
        "PyClaw": [(0.067, 0.0204)],
        "Landlab": [(0.018, 0.1215), (0.088, 0.1239)],
        "Itzi": [(0.006, 0.1325), (0.044, 0.1365)],
    },
    "ripple": {
        "ANUGA DE1": [(1.236, 0.294), (9.646, 0.1183)],
        "ANUGA DE0": [(0.666, 0.2203), (5.523, 0.1003)],
        "PyClaw": [(0.048, 0.219), (0.319, 0.0625)],
        "Landlab": [(0.029, 0.6173), (0.149, 0.4371)],
        "Itzi": [(0.012, 0.3277), (0.108, 0.3511)],
    },
}

# Pictures of the built-in bicycle, the camera and size of the bench of splatting: seconds of
# processor time of one thread, least of four, other programs beside, and the rms error against
# float64. The rasterizer of OpenSplat 1.1.5 (commit 15b7e80, -O3 for the machine's processor,
# PyTorch 2.13) on two cores, 2026-11-23, colour alone, splats behind the camera left out before.
SPLATTING = {
    "OpenSplat (recorded)": [(0.348, 0.00642)],
    "its near plane at 0.2": [(0.334, 0.000355)],
}
