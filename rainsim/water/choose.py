"""How "auto" decides: from the jumps of the surface over the depth, the dry share, the film share.

"accurate" is right everywhere, so what is decided is its Courant number. Smooth waves are carried
best with long steps: the fourth-order term cancels the errors of space and time together, and what
is left grows as steps get shorter. At fronts, bores and moving shorelines it fades, and the errors
in time that remain ask for shorter steps. Films are held back by friction; there either is right.
"""

import numpy as np

SCHEMES = ("auto", "accurate", "lean", "paper")
COURANTS = {"accurate": 0.4, "lean": 0.6, "paper": 0.5}
MAX_COURANT = {"auto": 0.7, "accurate": 0.7, "lean": 0.7, "paper": 0.5}
SMOOTH_COURANT, FRONT_COURANT = 0.6, 0.35
FRONT = 0.1  # jump of the surface between two cells, over the larger depth: above is a front
FILM = 1.0  # step of the bed over the depth: above, the water is a film that follows the ground


def choose(asked, h, bed):
    """Return scheme, Courant number and why, for depths h [m] on a bed [m]."""
    if asked != "auto":
        return asked, COURANTS[asked], "asked for by name"
    wet = h > 0
    if not wet.any():
        return "accurate", SMOOTH_COURANT, "auto: nothing flows"
    jump, films, faces = 0.0, 0, 0
    for axis in (0, 1):
        a, b = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        deep = np.maximum(h[a], h[b])
        step = np.abs(bed[b] - bed[a])
        rise = np.abs((bed[b] - bed[a]) + (h[b] - h[a]))
        # Water below the bed of a dry neighbour stands at a wall, not at a front.
        walled = (~wet[a] & (bed[a] >= bed[b] + h[b])) | (~wet[b] & (bed[b] >= bed[a] + h[a]))
        flows = (deep > 0) & ~walled
        film = flows & (step > FILM * deep)
        films, faces = films + int(film.sum()), faces + int(flows.sum())
        body = flows & ~film
        if body.any():
            jump = max(jump, float((rise[body] / deep[body]).max()))
    dry, film_share = 1.0 - wet.mean(), films / max(faces, 1)
    seen = f"{dry:.0%} dry, {film_share:.0%} film"
    if jump > FRONT:
        return (
            "accurate", FRONT_COURANT,
            f"auto: fronts, the surface jumps by up to {jump:.2g} of the depth; {seen}",
        )  # fmt: skip
    return (
        "accurate", SMOOTH_COURANT,
        f"auto: smooth, the surface jumps by at most {jump:.2g} of the depth; {seen}",
    )  # fmt: skip
