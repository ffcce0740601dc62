"""The ground under a scene: its height map, and where rain would stand on it."""

import rainsim
from rainsim.pipeline import extract_terrain
from rainsim.terrain import write_terrain
from rainsim.water.fill_spill_merge import standing_water


def main(out="height_map", scene="bicycle", past_rain=3e-3, **settings):
    """Write the height map of a scene into `out`; say how much of `past_rain` [m] stands on it."""
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    terrain = extract_terrain(scene, rainsim.Config().replace(**settings))
    for path in write_terrain(out, terrain):
        print(path)
    depth, runoff, infiltrated = standing_water(
        terrain.bed, past_rain, terrain.grid.spacing, permeable=terrain.soaks
    )
    standing = float(depth.sum()) * terrain.grid.cell_area
    print(f"{standing * 1e3:.1f} litres stand, at most {depth.max() * 1e3:.1f} mm deep")
    print(f"{runoff * 1e3:.1f} litres ran off, {infiltrated * 1e3:.1f} litres went into the lawn")
    return depth


if __name__ == "__main__":
    main()
