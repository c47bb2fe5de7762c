"""The fit of BMFR: blocks of pixels, their features, and least squares for all blocks at once."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

SIDE = 32  # pixels, side of a block
OFFSETS = (  # of the blocks in frame i mod 16, (right, down) in pixels, from the authors' code
    *((-14, -14), (4, -6), (-8, 14), (8, 0), (-10, -8), (2, 12), (12, -12), (-10, 0)),
    *((12, 14), (-8, -16), (6, 6), (-2, -2), (6, -14), (-16, 12), (14, -4), (-6, 4)),
)
UNSCALED = 4  # features that are used as they are: the constant and the normal
FEATURES = 10
MAX_DEPTH = 1e9  # so that the squares of positions are finite
RIDGE = 1e-3  # of every coefficient: blocks without a surface have a solution, 0
HASH_FACTOR, HASH_MASK = 0x45D9F3B, 2**32 - 1  # of a 32-bit integer hash (Mueller's)


class Blocks(NamedTuple):
    """The layout of displaced blocks: pixels beyond the border are mirrored."""

    source: Int[Tensor, "n place"]  # pixel of the image at each place, blocks one after another
    place: Int[Tensor, "n pixel"]  # where each pixel of the image lies

    def gather(self, image: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c blocks 1024"]:
        """The pixels of all blocks."""
        flat, index = image.flatten(2), self.source[:, None]
        return torch.unflatten(
            flat.gather(2, index.expand(-1, flat.shape[1], -1)), 2, (-1, SIDE**2)
        )

    def scatter(
        self, blocks: Float[Tensor, "n c blocks 1024"], h: int, w: int
    ) -> Float[Tensor, "n c h w"]:
        """The image of the blocks' pixels; undoes `gather`."""
        index = self.place[:, None].expand(-1, blocks.shape[1], -1)
        return torch.unflatten(blocks.flatten(2).gather(2, index), 2, (h, w))


def lay_blocks(frame: Int[Tensor, " n"], h: int, w: int) -> Blocks:
    """Blocks that cover images of h x w pixels, displaced by the offset of each clip's frame."""
    offset = torch.stack([block_offset(frame, axis) for axis in (0, 1)], 1) - SIDE // 2
    (x, columns), (y, rows) = (
        _cover(offset[:, axis, None], size) for axis, size in ((0, w), (1, h))
    )
    source = (y[:, :, None] * w + x[:, None]).view(len(y), rows, SIDE, -1, SIDE)
    source = source.transpose(2, 3).flatten(1)  # n place
    from_left, from_top = (
        torch.arange(size, device=frame.device) - offset[:, axis, None]
        for axis, size in ((0, w), (1, h))
    )
    in_block = (from_top % SIDE)[:, :, None] * SIDE + (from_left % SIDE)[:, None]
    block = (from_top // SIDE)[:, :, None] * columns + (from_left // SIDE)[:, None]
    return Blocks(source, (block * SIDE**2 + in_block).flatten(1))


def block_offset(frame: Int[Tensor, " n"], axis: int) -> Int[Tensor, " n"]:
    """The entry of OFFSETS for each frame, along an axis.

    The table is packed into two integers, 4 bits an entry: a tensor of it would be copied from the
    host in every frame.
    """
    step, bits = frame % len(OFFSETS), 4
    half = len(OFFSETS) // 2
    first, second = (
        sum((offset[axis] + 16) // 2 << bits * i for i, offset in enumerate(part))
        for part in (OFFSETS[:half], OFFSETS[half:])
    )
    packed = torch.where(step < half, first, second) >> bits * (step % half)
    return 2 * (packed & 15) - 16


def _cover(start: Int[Tensor, "n 1"], size: int) -> tuple[Int[Tensor, "n side"], int]:
    """The pixels of blocks along an axis from `start` on, mirrored, and the number of blocks."""
    count = -(-size // SIDE) + 1
    position = (start + torch.arange(count * SIDE, device=start.device)) % (2 * size)
    return torch.minimum(position, 2 * size - 1 - position), count


def stack_features(
    normal: Float[Tensor, "n 3 h w"], depth: Float[Tensor, "n 1 h w"]
) -> Float[Tensor, "n 10 h w"]:
    """1, normal, position in camera space, and its squares; depth is finite, at most 1e9."""
    _, _, h, w = depth.shape
    x, y = (torch.arange(s, device=depth.device) - (s - 1) / 2 for s in (w, h))
    ray = torch.stack(
        (x.expand(h, w) / h, y[:, None].expand(h, w) / h, torch.ones_like(depth[0, 0]))
    )
    position = depth.clamp_max(MAX_DEPTH) * ray
    return torch.cat((torch.ones_like(depth), normal, position, position.square()), 1)


def scale_features(
    features: Float[Tensor, "n 10 blocks 1024"], surface: Bool[Tensor, "n 1 blocks 1024"]
) -> Float[Tensor, "n 10 blocks 1024"]:
    """Positions and squares less their block's minimum, over their range where it exceeds 1.

    Minimum and range are those of pixels with a surface; other pixels have features 0.
    """
    plain, scaled = features[:, :UNSCALED], features[:, UNSCALED:]
    least = scaled.where(surface, torch.inf).amin(3, keepdim=True)
    most = scaled.where(surface, -torch.inf).amax(3, keepdim=True)
    scaled = (scaled - least) / (most - least).clamp_min(1)
    return torch.cat((plain, scaled), 1).where(surface, 0.0)


def feature_noise(frame: Int[Tensor, " n"], amplitude: float) -> Float[Tensor, "n 10 1 1024"]:
    """Noise up to `amplitude` for each frame; the same for all blocks, 0 for the constant."""
    count = FEATURES * SIDE**2
    value = torch.arange(count, device=frame.device) + frame[:, None] * count + 1
    for shift in (16, 16, 16):
        value = ((value ^ (value >> shift)) * HASH_FACTOR) & HASH_MASK
    noise = (value.to(torch.float32) / HASH_MASK * 2 - 1) * amplitude
    noise = noise.view(-1, FEATURES, 1, SIDE**2)
    return torch.cat((torch.zeros_like(noise[:, :1]), noise[:, 1:]), 1)


def solve_least_squares(
    features: Float[Tensor, "b k r"], values: Float[Tensor, "b c r"], ridge: float = RIDGE
) -> Float[Tensor, "b k c"]:
    """Coefficients x of each problem b, least |features^T x - values^T|^2 + |ridge x|^2.

    Householder reflections (Golub and Van Loan 2013, algorithm 5.2.1), in a loop over the k
    features: all problems at once, and no branch on a value.
    """
    b, k, _ = features.shape
    regular = ridge * torch.eye(k, device=features.device).expand(b, k, k)
    left = torch.cat((features, regular), 2)
    right = torch.cat((values, values.new_zeros(b, values.shape[1], k)), 2)
    columns = torch.cat((left, right), 1)  # b k+c rows
    for j in range(k):
        reflector = columns[:, j : j + 1, j:].clone()
        norm = reflector.square().sum(2).sqrt()
        diagonal = torch.where(reflector[..., 0] < 0, norm, -norm)
        reflector[..., 0] -= diagonal
        scale = 2 / reflector.square().sum(2, keepdim=True)
        rest = columns[:, j + 1 :, j:]
        rest -= (rest @ reflector.mT * scale) * reflector
        columns[:, j, j] = diagonal[:, 0]
    triangle, target = columns[:, :k, :k].mT, columns[:, k:, :k].mT
    return _substitute_back(triangle, target)


def _substitute_back(
    triangle: Float[Tensor, "b k k"], target: Float[Tensor, "b k c"]
) -> Float[Tensor, "b k c"]:
    """The solution of an upper triangular system."""
    solution: list[Tensor] = []  # from the last coefficient up
    k = triangle.shape[1]
    for i in reversed(range(k)):
        known = target[:, i]
        for j, value in zip(reversed(range(i + 1, k)), solution, strict=True):
            known = known - triangle[:, i, j, None] * value
        solution.append(known / triangle[:, i, i, None])
    return torch.stack(solution[::-1], 1)


def fit_blocks(
    light: Float[Tensor, "n 3 h w"],
    features: Float[Tensor, "n 10 h w"],
    surface: Bool[Tensor, "n 1 h w"],
    frame: Int[Tensor, " n"],
    noise: float,
) -> Float[Tensor, "n 3 h w"]:
    """The light that the features of each pixel predict, >= 0, by a fit to its block.

    Outside autocast: half precision has no digits left for sums over a block.
    """
    n, _, h, w = light.shape
    blocks = lay_blocks(frame, h, w)
    mask = blocks.gather(surface.to(light.dtype)) > 0
    clean = scale_features(blocks.gather(features), mask)
    target = blocks.gather(light).where(mask, 0.0)
    noisy = (clean + feature_noise(frame, noise)).where(mask, 0.0)
    noisy, target = (part.transpose(1, 2).flatten(0, 1) for part in (noisy, target))
    with torch.autocast(light.device.type, enabled=False):
        weights = solve_least_squares(noisy, target)  # (n blocks) 10 3
        fitted = weights.mT @ clean.transpose(1, 2).flatten(0, 1)
    return blocks.scatter(torch.unflatten(fitted, 0, (n, -1)).transpose(1, 2), h, w).clamp_min(0)
