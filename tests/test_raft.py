"""RAFT at the border: weights found, keys renamed, both ways at once. Untrained weights but where told."""

import os
from pathlib import Path

import numpy as np
import pytest

from vlmm_log.models.weights import find_raft
from vlmm_log.settings import FlowSettings
from vlmm_log.types import Frame, InputError

SHARED = Path(__file__).resolve().parents[2] / "shared/weights"
TRAINED = Path(os.environ.get("VLMM_LOG_WEIGHTS", SHARED)) / "raft-things.pth"
needs_torch = pytest.mark.skipif(
    __import__("importlib.util").util.find_spec("torchvision") is None,
    reason="torch and torchvision are not installed: pip install 'vlmm-log[raft]'",
)


def frames(shift):
    import cv2

    texture = np.random.default_rng(0).integers(0, 256, (160, 240, 3), np.uint8)
    texture = cv2.GaussianBlur(texture, (0, 0), 2.5)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    images = texture[:, 20:212], texture[:, 20 - shift : 212 - shift]
    depth, K = np.ones((160, 192), np.float32), np.eye(3)
    return [Frame(i, i, image.copy(), depth, K) for i, image in enumerate(images)]


def test_where_weights_are_looked_for(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("VLMM_LOG_WEIGHTS", str(tmp_path / "weights"))
    with pytest.raises(InputError, match="--flow dis"):
        find_raft("")
    for name in ("cache/vlmm-log/weights/raft-mine.pth", "weights/raft-a.pth", "weights/raft-things.pth", "one.pth"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    assert find_raft("").name == "raft-things.pth"
    assert find_raft(str(tmp_path / "one.pth")).name == "one.pth"
    monkeypatch.delenv("VLMM_LOG_WEIGHTS")
    assert find_raft("").name == "raft-mine.pth"
    with pytest.raises(InputError, match="no such weights"):
        find_raft(str(tmp_path / "absent.pth"))


@needs_torch
def test_a_file_that_holds_no_raft_is_told(tmp_path):
    from vlmm_log.models.raft import Raft

    (tmp_path / "raft.pth").write_bytes(b"not weights")
    with pytest.raises(InputError, match="not weights of RAFT large"):
        Raft(FlowSettings(estimator="raft", weights=str(tmp_path / "raft.pth")))


@needs_torch
def test_torchvision_keys_pass_and_both_ways_are_one_batch(tmp_path):
    import torch

    from vlmm_log.models.raft import Raft, _raft_large

    torch.manual_seed(0)
    torch.save(_raft_large().state_dict(), tmp_path / "raft-untrained.pth")
    raft = Raft(FlowSettings(estimator="raft", weights=str(tmp_path), raft_updates=2, raft_scale=1.0))
    a, b = frames(3)
    forward, backward = raft(a, b)
    assert forward.shape == backward.shape == (160, 192, 2)
    assert np.isfinite(forward).all()
    again, _ = raft(b, a)
    np.testing.assert_allclose(again, backward, atol=1e-3)


@needs_torch
def test_what_is_kept_of_a_frame_changes_nothing_and_torchvisions_own_pass_agrees(tmp_path):
    import torch

    from vlmm_log.models.raft import Raft, _raft_large

    torch.manual_seed(0)
    torch.save(_raft_large().state_dict(), tmp_path / "raft-untrained.pth")
    settings = FlowSettings(estimator="raft", weights=str(tmp_path), raft_updates=3, raft_scale=1.0)
    (a, b), (_, other) = frames(3), frames(7)
    raft, fresh = Raft(settings), Raft(settings)
    raft(other, a)  # the same index as b's, another image
    found = raft(a, b)
    for ours, theirs in zip(found, fresh(a, b), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    with torch.inference_mode():
        both = torch.from_numpy(np.stack([a.rgb, b.rgb])).permute(0, 3, 1, 2).float() / 127.5 - 1
        book = raft._network(both, both.flip(0), num_flow_updates=3)[-1].permute(0, 2, 3, 1).numpy()
    np.testing.assert_allclose(np.stack(found), book, atol=2e-3)


@needs_torch
@pytest.mark.skipif(
    not TRAINED.is_file(), reason=f"no trained weights at {TRAINED}; VLMM_LOG_WEIGHTS can name the folder"
)
@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 0.2), (0.5, 0.6)])
def test_trained_weights_in_princetons_keys_measure_a_known_shift(scale, tolerance):
    from vlmm_log.models.raft import Raft

    raft = Raft(FlowSettings(estimator="raft", weights=str(TRAINED), raft_scale=scale, raft_updates=12))
    forward, backward = raft(*frames(5))
    middle = (slice(40, 120), slice(50, 140))
    assert np.abs(np.median(forward[middle], axis=(0, 1)) - [5, 0]).max() < tolerance
    assert np.abs(np.median(backward[middle], axis=(0, 1)) - [-5, 0]).max() < tolerance
    assert raft.fingerprint.startswith("raft-things.pth sha256:fcfa4125")
