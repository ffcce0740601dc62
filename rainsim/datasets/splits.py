"""Which views of a data set are to train on, to validate and to test: no view is in two lists."""

from dataclasses import replace

from rainsim.errors import ParameterError

USUAL = 8  # every so many views one is held out
LEAST_VIEWS = 4  # for one view to test, one to validate and two to train on
NEEDS_TRAINING = "nerfstudio"  # its loader stops at an empty list to train on


def usual_hold_out(count):
    """Return every how many of `count` views one is held out unless the user says so.

    It is `USUAL`, and less where that would not hold out two: one to test and one to validate,
    since nerfstudio's trainer stops at an empty list to validate with. Of fewer than `LEAST_VIEWS`
    views none is held out: 0.
    """
    return min(USUAL, count // 2) if count >= LEAST_VIEWS else 0


def check_hold_out(every, count, layout):
    """Raise ParameterError if holding out every so many of `count` views leaves a list empty."""
    least = 2 if layout == NEEDS_TRAINING else 1
    if every == 0 or least <= every <= count:
        return
    left = "none" if every > count else "all"
    rule = f"from {least} to {count}, or 0 for none" if count >= least else "0 for none"
    raise ParameterError(
        f"--hold-out is {every} and holds out {left} of {_views(count)}; it must be {rule}; leave "
        "it out for the usual number, or give more --views"
    )


def held_out(views, every):
    """Return the views with every `every`-th held out; 0 holds none out."""
    return tuple(
        replace(view, held_out=every > 0 and view.moment % every == every - 1) for view in views
    )


def lists_of(views):
    """Return the views to train on, to validate and to test: held-out ones test first, in turn."""
    held = [view for view in views if view.held_out]
    tested = set(sorted({view.moment for view in held})[0::2])
    val, test = ([v for v in held if (v.moment in tested) == wanted] for wanted in (False, True))
    return [view for view in views if not view.held_out], val, test


def split_note(views, layout):
    """Return the line that says how a layout splits the views, and which of its lists are empty."""
    count, (train, val, test) = len(views), lists_of(views)
    held = len(val) + len(test)
    if layout == "nerfstudio":
        parts = {"train": len(train), "val": len(val), "test": len(test)}
    elif layout in ("acdc", "cityscapes", "kitti_object"):
        parts = {"train": len(train), "val": held}
    else:
        where = "card.json names them, files are not split" if held else "files are not split"
        if held and layout == "kitti":  # the second picture of a pair is the next view
            where += "; in a sequence the pair before each shows it, too: do not train on that"
        return f"{held} of {_views(count)} held out for tests; {where}"
    text = f"{_views(count)}: " + ", ".join(f"{n} in {name}" for name, n in parts.items())
    empty = [name for name, n in parts.items() if n == 0]
    if not empty:
        return text
    moments = len({view.moment for view in views})
    wanted = f"give --hold-out {usual_hold_out(moments)}"
    if moments < LEAST_VIEWS:
        wanted = f"take {LEAST_VIEWS} views or more"
        if moments < count:  # a rig has several pictures of each
            wanted += f" of the path, which has {moments}"
    elif empty == ["train"]:
        wanted = "give a greater --hold-out"
    hold = "holds" if len(empty) == 1 else "hold"
    return f"WARNING: {text}; {' and '.join(empty)} {hold} no picture; {wanted}"


def _views(count):
    return "1 view" if count == 1 else f"{count} views"
