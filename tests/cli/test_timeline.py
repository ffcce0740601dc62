"""The timeline example, as the README would run it, in few small frames."""

import json
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from rainsim.cli import cli
from rainsim.config.settings import Config, mm_per_hour
from rainsim.pipeline import extract_terrain, simulate
from rainsim.scene.folder import write_scene
from scenes import tiny_scene

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "timeline.toml"


def test_the_rain_comes_grows_and_ends_and_the_water_stands():
    config = Config.from_preset(EXAMPLE).replace(extent=1.0, spacing=0.04, fps=2.0).check()
    ground = extract_terrain(tiny_scene(), config)
    run = simulate(ground, config)
    states = [next(run) for _ in range(17)]  # 8 s
    water = np.array([s.depth.sum() for s in states])
    rain = np.diff([s.ledger["rain"] for s in states])
    assert water[0] == 0
    assert 0 < rain[3] < rain[6] < rain[9]  # light, moderate, heavy
    assert abs(rain[13:]).max() < 1e-9 and water[-1] > 0.3 * water.max() > 0
    assert abs(states[-1].ledger["residual"]) < 1e-6
    assert config.at(5.0).rain.rate == mm_per_hour(50.0)


def test_one_command_draws_it(tmp_path):
    write_scene(tmp_path / "scene", tiny_scene())
    done = CliRunner().invoke(
        cli,
        ["run", "--scene", str(tmp_path / "scene"), "--preset", str(EXAMPLE), "--width", "48",
         "--frames", "3", "--fps", "0.5", "--extent", "1", "--spacing", "0.04", "--out",
         str(tmp_path / "film"), "--json", "--quiet"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert len(json.loads(done.stdout)["frames"]) == 3
