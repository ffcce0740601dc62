"""Videos: an outside reader reads back what was written, in the codec that was asked for."""

import re
import subprocess

import numpy as np
import pytest

from rainsim.cli import cli
from rainsim.errors import RainsimError
from rainsim.io import video
from rainsim.io.video import CODECS, VideoFormat

WIDTH, HEIGHT, COUNT, FPS = 96, 64, 12, 24.0
READ_AS = {
    "h264": ("h264", "yuv420p"), "h265": ("hevc", "yuv420p"), "prores": ("prores", "yuv422p10le")
}  # fmt: skip
# The library leaves its pipes to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture(scope="module")
def ffmpeg():
    return pytest.importorskip("imageio_ffmpeg")


@pytest.fixture(scope="module")
def pictures():
    """A coloured slope with a little noise, as rain makes it, that gets brighter."""
    rng, (v, u) = np.random.default_rng(0), np.mgrid[:HEIGHT, :WIDTH]
    slope = np.stack([u * 2, v * 3, 150 - u], axis=-1)
    noise = rng.integers(-6, 7, (COUNT, HEIGHT, WIDTH, 1))
    bright = 4 * np.arange(COUNT)[:, None, None, None]
    return list(np.clip(slope + bright + noise, 0, 255).astype(np.uint8))


def written(folder, pictures, asked):
    path = folder / asked.name
    with video.VideoWriter(path, FPS, asked) as film:
        for picture in pictures:
            film.add(picture)
    return path


def needs(ffmpeg, codec):
    if CODECS[codec].encoder not in video._encoders(ffmpeg.get_ffmpeg_exe()):
        pytest.skip(f"this FFmpeg has no {codec}")


@pytest.mark.parametrize("quality", [None, 80])
@pytest.mark.parametrize("codec", list(CODECS))
def test_each_codec_is_read_back_with_all_frames(ffmpeg, tmp_path, pictures, codec, quality):
    needs(ffmpeg, codec)
    path = written(tmp_path, pictures, VideoFormat(codec, quality))
    assert path.suffix == (".mov" if codec == "prores" else ".mp4")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    frames = ffmpeg.read_frames(str(path))
    facts = next(frames)
    kind, pixels = READ_AS[codec]
    assert facts["codec"].split()[0] == kind and facts["pix_fmt"].startswith(pixels)
    assert facts["size"] == (WIDTH, HEIGHT) and facts["fps"] == FPS
    read = [np.frombuffer(f, np.uint8).reshape(HEIGHT, WIDTH, 3) for f in frames]
    assert len(read) == COUNT
    for picture, again in zip(pictures, read, strict=True):
        difference = again.astype(float) - picture
        assert np.abs(difference.mean(axis=(0, 1))).max() < 3  # no cast of colour
        assert np.sqrt((difference**2).mean()) < 8


@pytest.mark.parametrize("codec", list(CODECS))
def test_the_first_frame_s_number_is_the_time_code(ffmpeg, tmp_path, pictures, codec):
    needs(ffmpeg, codec)
    path = written(tmp_path, pictures, VideoFormat(codec, start=1001))
    shown = subprocess.run([ffmpeg.get_ffmpeg_exe(), "-i", path], capture_output=True, text=True)
    assert re.search(r"timecode *: 00:00:41:17", shown.stderr), shown.stderr
    assert sum(1 for _ in ffmpeg.read_frames(str(path))) == COUNT + 1  # the first are facts
    assert video.time_code(30 * 3600, 29.97) == "01:00:00:00"


@pytest.mark.parametrize("codec", list(CODECS))
def test_a_higher_quality_is_a_larger_file(ffmpeg, tmp_path, pictures, codec):
    needs(ffmpeg, codec)
    qualities = (0, 40, 70, 100)
    sizes = [written(tmp_path, pictures, VideoFormat(codec, q)).stat().st_size for q in qualities]
    assert sizes == sorted(sizes) and sizes[-1] > 2 * sizes[0]


def test_what_was_written_before_there_was_a_choice_is_written_by_itself():
    assert VideoFormat().settings == {"codec": "libx264", "quality": 8}
    assert VideoFormat().name == "video.mp4"


def test_a_quality_is_the_documented_rate_factor_or_quantiser():
    for quality, factor in ((66, "18"), (56, "23"), (67, "17.5"), (100, "1"), (0, "51")):
        for codec in ("h264", "h265"):
            more = VideoFormat(codec, quality).settings["output_params"]
            assert more[:2] == ["-crf", factor]
    for quality, step in ((0, "64"), (50, "8"), (100, "1")):
        assert VideoFormat("prores", quality).settings["output_params"][:2] == ["-qscale:v", step]


def test_the_options_are_the_codecs():
    for command in ("run", "render"):
        options = {option.name: option for option in cli.commands[command].params}
        assert list(options["video_codec"].type.choices) == list(CODECS)
    default = 2 * (video.WORST_CRF - 10)  # today's H.264 has a CRF of 10
    assert f"h264 {default:g}, h265 70" in options["video_quality"].show_default
    assert CODECS["h265"].usual == CODECS["h265"].rate(70)


def test_an_encoder_that_this_ffmpeg_lacks_is_refused(ffmpeg, monkeypatch):
    monkeypatch.setattr(video, "_encoders", lambda program: {"libx264", "mpeg4"})
    video.require_video()
    with pytest.raises(RainsimError, match=r"prores needs .* prores_ks, .* those of: h264; give"):
        video.require_video(VideoFormat("prores"))


def test_a_missing_encoder_is_told_with_its_remedy(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(RainsimError, match=r'pip install "rainsim\[video\]"'):
        video.require_video()


class OneFile:
    """Stands for the encoder: writes each frame's bytes to the file."""

    @staticmethod
    def write_frames(path, size, **settings):
        with open(path, "wb") as file:
            while True:
                frame = yield
                if frame is not None:
                    file.write(frame.tobytes())


def test_a_video_has_the_permissions_of_any_new_file(monkeypatch, tmp_path):
    monkeypatch.setattr(video, "_ffmpeg", lambda: OneFile)
    (tmp_path / "other").write_bytes(b"")
    frame = np.full((4, 6, 3), 7, np.uint8)
    with video.VideoWriter(tmp_path / "v.mp4", 24.0) as film:
        film.add(frame)
    assert (tmp_path / "v.mp4").read_bytes() == frame.tobytes()
    assert (tmp_path / "v.mp4").stat().st_mode == (tmp_path / "other").stat().st_mode
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other", "v.mp4"]


# The library leaves its pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_video_of_odd_size_is_written_whole(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    with video.VideoWriter(tmp_path / "v.mp4", 24.0) as film:
        for n in range(4):
            film.add(np.full((33, 47, 3), 60 * n, np.uint8))
    frames = ffmpeg.read_frames(str(tmp_path / "v.mp4"))
    meta = next(frames)
    assert meta["size"] == (48, 34)
    assert [np.frombuffer(f, np.uint8).mean() for f in frames] == pytest.approx(
        [0, 60, 120, 180], abs=4
    )
    assert [p.name for p in tmp_path.iterdir()] == ["v.mp4"]


def test_video_without_frames_leaves_what_was_there(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "v.mp4").write_bytes(b"before")
    with video.VideoWriter(tmp_path / "v.mp4", 24.0):
        pass
    assert (tmp_path / "v.mp4").read_bytes() == b"before"
