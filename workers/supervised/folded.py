"""SalsaNext and LMNet for CPU inference, with batch normalisation folded into convolutions.

The function is the same, in fewer passes over memory. A convolution is followed by LeakyReLU and
then by batch normalisation, which in evaluation is one scale and one offset per channel. Both are
folded into the weights of the convolutions that read the result. A padded convolution reads zeros
beyond the edge, not offsets, so its outermost pixels are computed a second time from the unfolded
input. LeakyReLU runs in oneDNN within the convolution, by the operator that torch's own compiler
uses. All of it is exact but for rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from workers.supervised.salsanext import SLOPE, ResBlock, ResContextBlock, SalsaNext, UpBlock

_SMALL: Final = 4096
"""Pixels of an image up to which one more pass is cheaper than recomputing its edges."""

_MERGED: Final = ([0, 0], [1, 1], [1, 1], 1)
"""Padding, stride, dilation and groups of a convolution that merges images."""


@dataclass(frozen=True, slots=True)
class Pending:
    """Pending affine map of a tensor: `scale * x + offset`, per channel, in float64."""

    scale: Tensor
    offset: Tensor

    def beside(self, *others: "Pending") -> "Pending":
        """Return the pending map of concatenated channels."""
        parts = (self, *others)
        return Pending(
            torch.cat([part.scale for part in parts]), torch.cat([part.offset for part in parts])
        )


def _nothing(channels: int) -> Pending:
    zeros = torch.zeros(channels, dtype=torch.float64)
    return Pending(zeros + 1, zeros)


def _pending(norm: nn.BatchNorm2d) -> Pending:
    """Return scale and offset of a normalisation in evaluation mode."""
    if norm.running_mean is None or norm.running_var is None:
        raise ValueError("a normalisation without statistics cannot be folded")
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    return Pending(scale, norm.bias.double() - norm.running_mean.double() * scale)


def _row(values: Tensor) -> Tensor:
    """Reshape numbers per channel for an image."""
    return values.float()[None, :, None, None].contiguous(memory_format=torch.channels_last)


class _Convolution:
    """A convolution with the pending map of its input folded in, and LeakyReLU."""

    def __init__(self, conv: nn.Conv2d, before: Pending, *, act: bool = True) -> None:
        if conv.bias is None or isinstance(conv.padding, str):
            raise ValueError("only convolutions with a bias and counted padding can be folded")
        weight = conv.weight.double()
        inner = (weight * before.offset[:, None, None]).sum(dim=(1, 2, 3))
        self._bias = (conv.bias.double() + inner).float()
        self._padding, self._dilation = conv.padding[0], conv.dilation[0]
        self._geometry = ([self._padding] * 2, [1, 1], [self._dilation] * 2, 1)
        self._weight = _packed(weight * before.scale[:, None, None], *self._geometry)
        self._plain, self._plain_bias = _packed(weight, *self._geometry), conv.bias.float()
        self._reach = (conv.kernel_size[0] - 1) * self._dilation
        self._scale, self._offset = _row(before.scale), _row(before.offset)
        self._has_edge = self._padding > 0 and bool((before.offset != 0).any())
        self._activation = ("leaky_relu", [SLOPE]) if act else ("none", [])

    def __call__(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to (B, O, H, W)."""
        rows, columns = x.shape[2:]
        if not self._has_edge:
            return self._run(x, self._weight, self._bias)
        if rows * columns <= _SMALL or min(rows, columns) < self._reach:
            return self._run(self._done(x), self._plain, self._plain_bias)
        out = self._run(x, self._weight, self._bias)
        width, reach = self._padding, self._reach
        for axis in (2, 3):
            far = x.shape[axis] - reach
            ends = torch.cat((x.narrow(axis, 0, reach), x.narrow(axis, far, reach)))
            near_end, far_end = self._run(self._done(ends), self._plain, self._plain_bias).chunk(2)
            out.narrow(axis, 0, width).copy_(near_end.narrow(axis, 0, width))
            last = out.shape[axis] - width
            out.narrow(axis, last, width).copy_(
                far_end.narrow(axis, far_end.shape[axis] - width, width)
            )
        return out

    def _done(self, x: Tensor) -> Tensor:
        return torch.addcmul(self._offset, x, self._scale)

    def _run(self, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        ran: Tensor = torch.ops.mkldnn._convolution_pointwise.default(
            x, weight, bias, *self._geometry, *self._activation, ""
        )
        return ran


class _Merge:
    """A 1 x 1 convolution over concatenated images, applied to each in turn without a copy."""

    def __init__(self, conv: nn.Conv2d, before: Sequence[Pending]) -> None:
        joined = before[0].beside(*before[1:])
        if conv.bias is None:
            raise ValueError("only convolutions with a bias can be folded")
        weight = conv.weight.double()
        self._bias = (conv.bias.double() + weight[:, :, 0, 0] @ joined.offset).float()
        scaled = weight * joined.scale[:, None, None]
        sizes = [len(part.scale) for part in before]
        self._weights = [_packed(part, *_MERGED) for part in torch.split(scaled, sizes, dim=1)]

    def __call__(self, images: Sequence[Tensor]) -> Tensor:
        """Map images (B, C_i, H, W) to (B, O, H, W)."""
        first, *others = zip(images, self._weights, strict=True)
        out: Tensor = torch.ops.mkldnn._convolution_pointwise.default(
            *first, self._bias, *_MERGED, "none", [], ""
        )
        for image, weight in others:
            torch.ops.mkldnn._convolution_pointwise_.binary(
                out, image, weight, None, *_MERGED, "add", None, None, [], None
            )
        return functional.leaky_relu_(out, SLOPE)


def _packed(
    weight: Tensor, padding: list[int], stride: list[int], dilation: list[int], groups: int
) -> Tensor:
    """Bring the weights of a convolution into oneDNN's own order, which each call would else do."""
    rows = weight.float().contiguous(memory_format=torch.channels_last)
    packed: Tensor = torch.ops.mkldnn._reorder_convolution_weight(
        rows, padding, stride, dilation, groups
    )
    return packed


class _Context:
    def __init__(self, block: ResContextBlock, before: Pending) -> None:
        self._conv1 = _Convolution(block.conv1, before)
        self._conv2 = _Convolution(block.conv2, _nothing(block.conv2.in_channels))
        self._conv3 = _Convolution(block.conv3, _pending(block.bn1))
        last = _pending(block.bn2)
        self._scale, self.after = _row(last.scale), Pending(last.scale * 0 + 1, last.offset)

    def __call__(self, x: Tensor) -> Tensor:
        shortcut = self._conv1(x)
        return torch.addcmul(shortcut, self._conv3(self._conv2(shortcut)), self._scale)


class _Three:
    """Three convolutions of growing receptive field, and one over all their outputs."""

    def __init__(
        self, convs: tuple[nn.Conv2d, ...], norms: tuple[nn.BatchNorm2d, ...], before: Pending
    ) -> None:
        done = [before, *(_pending(norm) for norm in norms)]
        self._convs = [
            _Convolution(conv, wait) for conv, wait in zip(convs[:3], done[:3], strict=True)
        ]
        self._merge = _Merge(convs[3], done[1:4])
        self.after = done[4]

    def __call__(self, x: Tensor) -> Tensor:
        found = []
        for conv in self._convs:
            x = conv(x)
            found.append(x)
        return self._merge(found)


class _Encoder:
    def __init__(self, block: ResBlock, before: Pending) -> None:
        self._shortcut = _Convolution(block.conv1, before)
        self._three = _Three(
            (block.conv2, block.conv3, block.conv4, block.conv5),
            (block.bn1, block.bn2, block.bn3, block.bn4),
            before,
        )
        last = self._three.after
        self._scale, self._offset = _row(last.scale), _row(last.offset)
        self.after = Pending(last.scale * 0 + 1, last.offset)

    def __call__(self, x: Tensor) -> Tensor:
        return torch.addcmul(self._shortcut(x), self._three(x), self._scale)

    def pool(self, skip: Tensor) -> Tensor:
        """Halve the image; windows at its upper and left edge contain fewer offsets than others."""
        pooled = functional.avg_pool2d(skip, 3, stride=2, padding=1)
        pooled[:, :, :1] -= self._offset / 3
        pooled[:, :, :, :1] -= self._offset / 3
        pooled[:, :, :1, :1] += self._offset / 9
        return pooled


class _Decoder:
    def __init__(self, block: UpBlock, before: Pending, skip: Pending) -> None:
        self._scale, self._offset = _row(before.scale), _row(before.offset)
        raised = _nothing(block.conv1.in_channels - len(skip.scale))
        self._three = _Three(
            (block.conv1, block.conv2, block.conv3, block.conv4),
            (block.bn1, block.bn2, block.bn3, block.bn4),
            raised.beside(skip),
        )
        self.after = self._three.after

    def __call__(self, x: Tensor, skip: Tensor) -> Tensor:
        raised = functional.pixel_shuffle(torch.addcmul(self._offset, x, self._scale), 2)
        return self._three(torch.cat((raised, skip), dim=1))


class FoldedSalsaNext:
    """A trained SalsaNext or LMNet, folded; float32, on the CPU.

    Args:
        net: In any mode; not changed, and not needed afterwards.
    """

    def __init__(self, net: SalsaNext) -> None:
        with torch.no_grad():
            pending = _nothing(net.downCntx.conv1.in_channels)
            self._contexts = []
            for context in (net.downCntx, net.downCntx2, net.downCntx3):
                self._contexts.append(_Context(context, pending))
                pending = self._contexts[-1].after
            self._encoders = []
            for encoder in (
                net.resBlock1,
                net.resBlock2,
                net.resBlock3,
                net.resBlock4,
                net.resBlock5,
            ):
                self._encoders.append(_Encoder(encoder, pending))
                pending = self._encoders[-1].after
            self._decoders = []
            decoders = (net.upBlock1, net.upBlock2, net.upBlock3, net.upBlock4)
            for decoder, beside in zip(decoders, self._encoders[-2::-1], strict=True):
                self._decoders.append(_Decoder(decoder, pending, beside.after))
                pending = self._decoders[-1].after
            self._logits = _Convolution(net.logits, pending, act=False)

    def __call__(self, x: Tensor) -> Tensor:
        """Return the probability of every class in every pixel, as `SalsaNext.forward` does.

        Args:
            x: (B, in_channels, H, W) normalised; H and W multiples of 16.

        Returns:
            (B, classes, H, W) that sum to 1 over the classes.
        """
        x = x.contiguous(memory_format=torch.channels_last)
        for context in self._contexts:
            x = context(x)
        skips = []
        for encoder in self._encoders[:-1]:
            skips.append(encoder(x))
            x = encoder.pool(skips[-1])
        x = self._encoders[-1](x)
        for decoder in self._decoders:
            x = decoder(x, skips.pop())
        return functional.softmax(self._logits(x), dim=1)
