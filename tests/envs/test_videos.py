"""Videos of the environments with PettingZoo's and TorchRL's own recorders, as files that play."""

import numpy as np
import pytest
import torch
from imageio_ffmpeg import read_frames
from pettingzoo.utils.wrappers.record_video import RecordVideo
from pettingzoo.utils.wrappers.record_video_parallel import RecordVideoParallel
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.record import PixelRenderTransform, VideoRecorder
from torchrl.record.loggers import CSVLogger

from marl_lanes import LaneChangeEnv, env, parallel_env
from marl_lanes.colours import TRAFFIC

torch.set_num_threads(1)

SIZE = (640, 360)
YELLOW = np.array(list(bytes.fromhex(TRAFFIC.vehicle[1:])))


def count_yellow(picture):
    """Pixels of vehicles; a video's colours are not exact."""
    return (np.abs(picture.astype(int) - YELLOW) < 60).all(axis=-1).sum()


def assert_is_film(pictures, number):
    """So many pictures (N, H, W, 3) with cars that move."""
    assert pictures.shape == (number, SIZE[1], SIZE[0], 3)
    assert min(map(count_yellow, pictures)) > 100
    moved = np.abs(np.diff(pictures.astype(int), axis=0)).max(axis=-1) > 60
    assert (moved.sum(axis=(1, 2)) > 20).all()


# imageio-ffmpeg leaves the pipes of its program to be collected.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.slow
@pytest.mark.parametrize("form", ["cycle", "parallel"])
def test_pettingzoos_recorder_writes_a_film(tmp_path, form):
    zero = np.zeros(1, np.float32)
    options = {"render_mode": "rgb_array", "view": {"size": SIZE}}
    if form == "cycle":
        film = RecordVideo(env("dense", **options), tmp_path / "film", video_length=20)
        film.reset(seed=0)
        for _ in range(25 * 10):
            if film.recording:
                film.step(None if film.last()[2] or film.last()[3] else zero)
    else:
        film = RecordVideoParallel(
            parallel_env("dense", **options), tmp_path / "film", video_length=20
        )
        film.reset(seed=0)
        while film.recording:
            film.step(dict.fromkeys(film.agents, zero))
    film.close()
    (file,) = (tmp_path / "film").glob("*.mp4")
    frames = read_frames(file)
    about = next(frames)
    assert about["size"] == SIZE
    assert about["fps"] == 10.0
    pictures = np.stack([np.frombuffer(frame, np.uint8) for frame in frames])
    pictures = pictures.reshape(-1, SIZE[1], SIZE[0], 3)
    if form == "cycle":
        # A cycle has as many pictures as agents; the road moves after the last of them.
        has_moved = np.abs(np.diff(pictures.astype(int), axis=0)).max(axis=(1, 2, 3)) > 60
        pictures = pictures[np.concatenate([[True], has_moved])]
        assert_is_film(pictures, len(pictures))
        assert len(pictures) > 5
    else:
        assert_is_film(pictures, 21)


def test_torchrls_recorder_writes_a_film(tmp_path):
    roads = LaneChangeEnv("dense", 2, render_mode="rgb_array", view={"size": SIZE}, seed=0)
    logger = CSVLogger("road", log_dir=str(tmp_path))
    film = TransformedEnv(
        roads, Compose(PixelRenderTransform(road=1), VideoRecorder(logger, "one"))
    )
    film.rollout(10, break_when_any_done=False)
    film.transform[1].obs.clear()
    film.rollout(10, break_when_any_done=False)
    film.transform.dump()
    (file,) = tmp_path.glob("**/videos/*.pt")
    video = torch.load(file, weights_only=True)
    assert_is_film(video[0].permute(0, 2, 3, 1).numpy(), 11)


def test_pixels_agree_with_the_specs():
    roads = LaneChangeEnv("dense", 2, render_mode="rgb_array", view={"size": SIZE}, seed=0)
    film = TransformedEnv(roads, PixelRenderTransform(road=1))
    check_env_specs(film)
    last = film.rollout(3)[0, -1]["next", "pixels"]
    assert np.array_equal(last, roads.render(1))
