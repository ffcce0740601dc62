"""Our export as nerfstudio's own data parser reads it, where nerfstudio is installed.

Its pins clash with those of the page's viewer, so it needs an environment of its own; run with
1.1.5. `test_datasets.py` has the parser's rules written out.
"""

import numpy as np
import pytest
from test_datasets import LENSES, plan_with, write_set

from rainsim.datasets.splits import lists_of

pytest.importorskip("nerfstudio")
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

PERSPECTIVE, FISHEYE = 1, 2  # nerfstudio's numbers of camera models


def parsed(folder, split):
    from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig

    options = {"load_3D_points": True, "downscale_factor": 1, "center_method": "none",
               "auto_scale_poses": False}  # fmt: skip
    return NerfstudioDataParserConfig(data=folder, **options).setup().get_dataparser_outputs(split)


@pytest.mark.parametrize("lens", LENSES[:2] + LENSES[3:], ids=("none", "opencv", "fisheye"))
def test_nerfstudio_reads_an_export(tmp_path, lens):
    plan = plan_with(lens, count=6)
    write_set(tmp_path, plan)
    for split, views in zip(("train", "val", "test"), lists_of(plan.views), strict=True):
        found = parsed(tmp_path / "rain/10mm", split)
        assert [path.stem for path in found.image_filenames] == [view.name for view in views]
        assert len(found.mask_filenames) == len(found.metadata["depth_filenames"]) == len(views)
        assert found.metadata["depth_unit_scale_factor"] == 1e-3
        assert found.dataparser_scale == 1  # so that depths in mm stay in the poses' unit
        np.testing.assert_allclose(found.metadata["points3D_xyz"], plan.points, atol=1e-6)
        np.testing.assert_array_equal(found.metadata["points3D_rgb"], plan.colors)
        cameras = found.cameras
        model = FISHEYE if lens is not None and lens.model == "fisheye" else PERSPECTIVE
        for k, view in enumerate(views):
            own = view.camera
            assert cameras.camera_type[k].item() == model
            assert (cameras.width[k].item(), cameras.height[k].item()) == (own.width, own.height)
            for name in ("fx", "fy", "cx", "cy"):
                assert getattr(cameras, name)[k].item() == pytest.approx(getattr(own, name))
            place = cameras.camera_to_worlds[k].numpy()
            np.testing.assert_allclose(place[:, 3], own.position, atol=1e-6)
            axes = own.camera_from_world[:3, :3].T * (1, -1, -1)  # x right, y up, z back
            np.testing.assert_allclose(place[:, :3], axes, atol=1e-6)
            if lens is not None:
                assert cameras.distortion_params[k, 0].item() == pytest.approx(0.1)
