"""Recorded figures of other programs: points of the charts of water and of splatting.

Hydraulics codes on the cases of `rainsim bench water`: one run of each code on two shared cores of
a server processor, one thread; seconds are processor time, errors relative L1, as in the bench.
They are older than the table of docs/compared.md, whose scripts are in examples/peers.
Cases that a code did not finish are left out, and so is rain on a slope, whose friction the codes
define in other ways.
"""

SECONDS_AND_ERRORS = {  # by case and code, coarse grids first; sizes are those of the bench or half
    "stoker": {
        "ANUGA DE1": [(0.117, 0.00359), (0.449, 0.00178), (1.55, 0.00105)],
        "ANUGA DE0": [(0.0602, 0.00594), (0.173, 0.00323), (0.803, 0.00191)],
        "PyClaw": [(0.00959, 0.0106), (0.034, 0.00556), (0.144, 0.00279), (0.582, 0.00166)],
        "Landlab": [(0.00487, 0.0605), (0.0104, 0.0615), (0.0277, 0.0624), (0.101, 0.0637)],
        "Itzi": [(0.000793, 0.0638), (0.00267, 0.0644), (0.0098, 0.061), (0.0391, 0.0596)],
    },
    "ritter": {
        "ANUGA DE1": [(0.103, 0.00483), (0.452, 0.0022), (1.63, 0.00116)],
        "ANUGA DE0": [(0.0674, 0.00857), (0.224, 0.00475), (0.904, 0.00272)],
        "PyClaw": [(0.00913, 0.0177), (0.0366, 0.00926), (0.158, 0.00468), (0.628, 0.00261)],
        "Landlab": [(0.00587, 0.108), (0.0141, 0.107), (0.0291, 0.105), (0.0916, 0.103)],
        "Itzi": [(0.000695, 0.119), (0.00215, 0.115), (0.00782, 0.109), (0.0293, 0.105)],
    },
    "bowl planar": {
        "ANUGA DE1": [(2.27, 0.033)],
        "ANUGA DE0": [(1.59, 0.0623)],
        "Landlab": [(0.0525, 0.902), (0.21, 0.994)],
    },
    "bowl radial": {
        "ANUGA DE1": [(0.674, 0.0218)],
        "ANUGA DE0": [(0.374, 0.0261), (3.29, 0.0108)],
        "PyClaw": [(0.0908, 0.0161)],
        "Landlab": [(0.0268, 0.125), (0.0956, 0.131), (0.613, 0.144)],
        "Itzi": [(0.00618, 0.13), (0.0464, 0.136), (0.373, 0.149)],
    },
    "ripple": {
        "ANUGA DE1": [(1.71, 0.304)],
        "ANUGA DE0": [(0.877, 0.235)],
        "PyClaw": [(0.133, 0.325), (0.875, 0.21)],
        "Landlab": [(0.0286, 0.552), (0.205, 0.38), (1.28, 0.236)],
        "Itzi": [(0.0147, 0.434), (0.126, 0.217), (1.11, 0.105)],
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
