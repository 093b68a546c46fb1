"""open_clip's ViT-B/16: images and texts in, unit features out. Radford et al., ICML 2021; Ilharco et al., 2021.

Tensors, device, batches and pixel statistics end here: what goes in and comes out is numpy.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlmm_log.models.weights import fingerprint, reason
from vlmm_log.types import Float32, InputError, UInt8

try:
    import torch
    from torch.nn import functional

    from vlmm_log.models.torchvision_operators import declare_missing_operators

    declare_missing_operators()
    import open_clip
    from PIL import Image
    from safetensors.torch import load_file
except ImportError as e:
    raise InputError(
        "objects.embedder = clip and maskclip need torch and open_clip: pip install 'vlmm-log[clip]'"
    ) from e

WIDTH = 512
SIDE = 224  # px, of the square that the image tower was trained on
PATCH = 16  # px
MEAN_COLOR = np.array(open_clip.OPENAI_DATASET_MEAN)  # RGB in 0..1; 0 to the tower
GPU_BATCH = 32


class ClipNetwork:
    """Both towers, on the best device there is. A feature does not depend on what else is asked for with it."""

    def __init__(self, weights: Path) -> None:
        """Raises InputError where the file holds no weights of a ViT-B/16."""
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        # a row's last bits depend on the size of its batch, so there is one size; on a CPU more than 1 gains little
        self._batch = GPU_BATCH if self._device.type == "cuda" else 1
        name = architecture(weights)
        self._network = load(weights, name).to(self._device)
        self.space = f"{name} {fingerprint(weights)} torch {torch.__version__} {self._device.type}"

    def images(self, squares: Sequence[UInt8]) -> Float32:
        """(n, WIDTH) features of square RGB images of any size."""
        pixels = [_pixels(square, SIDE, SIDE) for square in squares]
        return self._encoded(pixels, self._network.encode_image)

    def texts(self, texts: Sequence[str]) -> Float32:
        """(n, WIDTH) features."""
        return self._encoded(list(open_clip.tokenize(list(texts))), self._network.encode_text)

    def patches(self, rgb: UInt8, px: int) -> Float32:
        """(h, w, WIDTH) features of the patches of an image scaled to ``px`` along its longer side: MaskCLIP.

        Zhou, Loy and Dai, ECCV 2022: in the last block each patch attends to itself alone, which leaves the value path.
        """
        h, w = (max(1, round(n * px / max(rgb.shape[:2]) / PATCH)) for n in rgb.shape[:2])
        tower = self._network.visual
        with torch.inference_mode():
            pixels = _pixels(rgb, h * PATCH, w * PATCH)[None].to(self._device)
            x = tower.conv1(pixels).flatten(2).transpose(1, 2)
            x = torch.cat([tower.class_embedding.expand(1, 1, -1), x], 1) + _positions(tower, h, w)
            *blocks, last = tower.transformer.resblocks
            x = tower.ln_pre(x)
            for block in blocks:
                x = block(x)
            x = x + _values(last.attn, last.ln_1(x))
            x = x + last.mlp(last.ln_2(x))
            features = tower.ln_post(x[0, 1:]) @ tower.proj
            return _unit(features).reshape(h, w, WIDTH)

    def _encoded(self, items: list[Any], encode: Any) -> Float32:
        with torch.inference_mode():
            batches = [_unit(encode(batch.to(self._device))[:n]) for batch, n in _batches(items, self._batch)]
        return np.concatenate([np.zeros((0, WIDTH), np.float32), *batches])


def architecture(weights: Path) -> str:
    """open_clip's name for it. Weights do not tell their activation: a file's name must, as OpenAI's own do."""
    quick = any(word in weights.name.lower() for word in ("openai", "quickgelu"))
    return "ViT-B-16-quickgelu" if quick else "ViT-B-16"


def load(weights: Path, name: str) -> Any:
    """The network with a local file's weights. Raises InputError."""
    try:
        if weights.suffix == ".safetensors":
            state = load_file(weights)
        else:
            state = torch.load(weights, map_location="cpu", weights_only=True)
            state = state.get("state_dict", state)
        state = {key.removeprefix("module."): value for key, value in state.items()}
        network = open_clip.CLIP(**open_clip.get_model_config(name))
        network.load_state_dict(state)
    except Exception as e:
        raise InputError(f"{weights}: not weights of open_clip's ViT-B/16 ({reason(e)})") from e
    return network.eval()


def _pixels(rgb: UInt8, height: int, width: int) -> Any:
    """(3, height, width) tensor by open_clip's own preprocessing."""
    prepare = open_clip.image_transform((height, width), is_train=False, resize_mode="squash")
    return prepare(Image.fromarray(rgb))


def _batches(items: list[Any], size: int) -> Iterator[tuple[Any, int]]:
    """Tensors of exactly ``size`` rows, and how many of them count."""
    for start in range(0, len(items), size):
        some = items[start : start + size]
        yield torch.stack(some + some[:1] * (size - len(some))), len(some)


def _positions(tower: Any, h: int, w: int) -> Any:
    """The position embedding, its square grid resampled to h x w patches."""
    first, grid = tower.positional_embedding[:1], tower.positional_embedding[1:]
    side = SIDE // PATCH
    square = grid.reshape(1, side, side, -1).permute(0, 3, 1, 2)
    resampled = functional.interpolate(square, (h, w), mode="bicubic", align_corners=False)
    return torch.cat([first, resampled.flatten(2)[0].T])


def _values(attention: Any, x: Any) -> Any:
    """What attention gives where each token attends to itself alone."""
    weight, bias = attention.in_proj_weight, attention.in_proj_bias
    third = weight.shape[0] // 3
    return attention.out_proj(functional.linear(x, weight[-third:], bias[-third:]))


def _unit(features: Any) -> Float32:
    return np.asarray(functional.normalize(features.float(), dim=-1).cpu().numpy())
