"""One option with a value that nobody means: a line that says so, or a result, soon."""

import pytest

from hostile_options import NUMBERS, cases, run

SMALL = ["--spacing", "0.04", "--extent", "1", "--out", "out", "--overwrite"]
COMMANDS = {
    "run": ["--scene", "tiny", *SMALL, "--frames", "2", "--width", "64"],
    "splat": ["tiny", "--width", "64", "--out", "a.png", "--overwrite"],
    "heightmap": ["tiny", *SMALL],
    "import": ["tiny", "--out", "out", "--overwrite"],
    "lidar": ["tiny", *SMALL, "--rain", "0,50"],
    "export": ["tiny", *SMALL, "--width", "64"],
}


@pytest.mark.parametrize("command", ["run", "lidar"])
def test_values_are_checked_before_a_scene_is_read(rainsim, command):
    tried = set()
    for arguments in list(cases(command, *COMMANDS[command]))[::4]:
        done = rainsim(*(a if a != "tiny" else "no-such-scene" for a in arguments))
        assert done.code in (1, 2) and done.error, arguments
        name = arguments[-1].partition("=")[0]
        tried.add((name, "no-such-scene" in done.error))
    named = {name for name, is_later in tried if not is_later}
    assert len(named) > 8 and len(named) > 0.7 * len({name for name, _ in tried}), tried


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_with_hostile_values(scene_folder, command):
    faults, tried = [], 0
    for arguments in cases(command, *COMMANDS[command]):
        tried += 1
        fault = run(arguments, scene_folder.parent)
        if fault is not None:
            faults.append(f"{' '.join(arguments)}: {fault}")
    print(f"{command}: {tried} commands with hostile options, {len(faults)} faults")
    assert tried > len(NUMBERS) and not faults, "\n".join(faults)
