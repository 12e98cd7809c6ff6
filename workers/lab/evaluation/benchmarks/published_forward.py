"""Published forward passes, transcribed operator by operator as a baseline for timing.

The project's networks are timed against them: eager torch, one operator after the other, every
search and every sampling repeated where the published code repeats it. They take the parameters of
the project's networks, so that both sides of a comparison compute the same function.
"""

import torch
from torch import Tensor
from torch.nn import functional

from workers.paper.flowstep3d import FlowStep3D, GlobalCorrelation, SetConv
from workers.paper.point_sets import NEAREST_M, gather_features, sample_furthest
from workers.supervised.salsanext import SLOPE, ResBlock, ResContextBlock, SalsaNext, UpBlock


def salsanext(net: SalsaNext, x: Tensor) -> Tensor:
    """Run SalsaNext or LMNet: (B, in_channels, H, W) to (B, classes, H, W)."""
    for context in (net.downCntx, net.downCntx2, net.downCntx3):
        x = _context(context, x)
    skips = []
    for encoder in (net.resBlock1, net.resBlock2, net.resBlock3, net.resBlock4):
        skips.append(_encode(encoder, x))
        x = functional.avg_pool2d(encoder.dropout(skips[-1]), 3, stride=2, padding=1)
    x = _encode(net.resBlock5, x)
    for decoder in (net.upBlock1, net.upBlock2, net.upBlock3, net.upBlock4):
        x = _decode(decoder, x, skips.pop())
    return functional.softmax(net.logits(x), dim=1)


def _act(x: Tensor) -> Tensor:
    return functional.leaky_relu(x, SLOPE)


def _context(block: ResContextBlock, x: Tensor) -> Tensor:
    shortcut = _act(block.conv1(x))
    near = block.bn1(_act(block.conv2(shortcut)))
    wide: Tensor = block.bn2(_act(block.conv3(near)))
    return shortcut + wide


def _encode(block: ResBlock, x: Tensor) -> Tensor:
    shortcut = _act(block.conv1(x))
    first = block.bn1(_act(block.conv2(x)))
    second = block.bn2(_act(block.conv3(first)))
    third = block.bn3(_act(block.conv4(second)))
    merged: Tensor = block.bn4(_act(block.conv5(torch.cat((first, second, third), dim=1))))
    return shortcut + merged


def _decode(block: UpBlock, x: Tensor, skip: Tensor) -> Tensor:
    joined = torch.cat((functional.pixel_shuffle(x, 2), skip), dim=1)
    first = block.bn1(_act(block.conv1(joined)))
    second = block.bn2(_act(block.conv2(first)))
    third = block.bn3(_act(block.conv3(second)))
    merged: Tensor = block.bn4(_act(block.conv4(torch.cat((first, second, third), dim=1))))
    return merged


def flowstep3d(net: FlowStep3D, cloud: Tensor, next_cloud: Tensor, *, iterates: int = 5) -> Tensor:
    """Run FlowStep3D: (B, N, 3) and (B, M, 3) metres to the last flow (B, N, 3)."""
    half, quarter, *_ = sizes = net.level_sizes(cloud.shape[1])
    points, features, chosen = _encode_local(net, cloud, (half, quarter), None)
    others, other_features, _ = _encode_local(net, next_cloud, (half, quarter), None)
    levels, coarse = _encode_global(net, points, features, sizes[2:])
    other_levels, other_coarse = _encode_global(net, others, other_features, sizes[2:])
    correlation = _correlate(net.global_corr_layer, levels, coarse, other_levels[-1], other_coarse)
    described = _set_conv(net.flow0_regressor.sa1, points, correlation, quarter)[1]
    step = net.flow0_regressor.fc(described.transpose(1, 2))
    hidden = torch.tanh(_chain(net.h0_net.sa1, net.h0_net.sa2, points, features, quarter))
    moved, low_moved = cloud + _upsample(step, points, cloud), points + step
    for iterate in range(iterates - 1):
        warped, seen, _ = _encode_local(net, moved, (half, quarter), chosen)
        low_flow = (low_moved - points).transpose(1, 2)
        compared = _embed(net, warped, seen, others, other_features)
        flow = _chain(net.flow_conv1, net.flow_conv2, points, low_flow, quarter)
        new = torch.cat((seen, compared, flow, low_flow), dim=1)
        both = torch.cat((hidden, new), dim=1)
        update = torch.sigmoid(_set_conv(net.gru.convz, points, both, quarter)[1])
        reset = torch.sigmoid(_set_conv(net.gru.convr, points, both, quarter)[1])
        renewed = torch.cat((reset * hidden, new), dim=1)
        fresh = torch.tanh(_set_conv(net.gru.convq, points, renewed, quarter)[1])
        hidden = (1 - update) * hidden + update * fresh
        regressor = net.flow_regressor
        described = _chain(regressor.sa1, regressor.sa2, points, hidden, quarter)
        step = regressor.fc(described.transpose(1, 2)) / (net.decay * iterate + 1)
        low_moved = low_moved + step
        moved = moved + _upsample(step, points, cloud)
    return moved - cloud


def _near(queries: Tensor, points: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Search all points of all queries at once."""
    far = torch.cdist(queries, points, compute_mode="donot_use_mm_for_euclid_dist")
    found = far.topk(min(count, points.shape[1]), dim=2, largest=False)
    return found.values, found.indices


def _set_conv(
    layer: SetConv, points: Tensor, features: Tensor, count: int, chosen: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Sample, group and describe: returns the centres, their features, and their indices."""
    chosen = sample_furthest(points, count) if chosen is None else chosen
    positions = points.transpose(1, 2)
    centres = gather_features(positions, chosen)
    index = _near(centres.transpose(1, 2), points, layer.neighbours)[1]
    way = gather_features(positions, index) - centres[:, :, :, None]
    grouped = torch.cat((way, gather_features(features, index)), dim=1)
    return centres.transpose(1, 2), _describe(layer, grouped), chosen


def _describe(layer: SetConv, grouped: Tensor) -> Tensor:
    for conv, norm in zip(layer.mlp_convs, layer.mlp_bns, strict=True):
        grouped = conv(grouped)
        if layer.act:
            grouped = torch.relu(norm(grouped))
    return grouped.amax(dim=3)


def _chain(first: SetConv, second: SetConv, points: Tensor, features: Tensor, n: int) -> Tensor:
    points, features, _ = _set_conv(first, points, features, n)
    return _set_conv(second, points, features, n)[1]


def _encode_local(
    net: FlowStep3D, cloud: Tensor, sizes: tuple[int, int], chosen: list[Tensor] | None
) -> tuple[Tensor, Tensor, list[Tensor]]:
    points, features, kept = cloud, cloud.transpose(1, 2), []
    layers = (net.encoder_loc.sa1, net.encoder_loc.sa2)
    for place, (layer, size) in enumerate(zip(layers, sizes, strict=True)):
        given = None if chosen is None else chosen[place]
        points, features, index = _set_conv(layer, points, features, size, given)
        kept.append(index)
    return points, features, kept


def _encode_global(
    net: FlowStep3D, points: Tensor, features: Tensor, sizes: tuple[int, ...]
) -> tuple[list[Tensor], Tensor]:
    levels = [points]
    layers = (net.encoder_glob.sa1, net.encoder_glob.sa2, net.encoder_glob.sa3)
    for layer, size in zip(layers, sizes, strict=True):
        points, features, _ = _set_conv(layer, points, features, size)
        levels.append(points)
    return levels, features


def _correlate(
    layer: GlobalCorrelation,
    levels: list[Tensor],
    features: Tensor,
    others: Tensor,
    other_features: Tensor,
) -> Tensor:
    quarter, eighth, sixteenth, coarsest = levels
    one, two = (
        each / (each.square().sum(dim=1, keepdim=True) + 1e-8).sqrt()
        for each in (features, other_features)
    )
    alike = torch.exp((one.transpose(1, 2) @ two - 1) / (torch.exp(layer.epsilon) + 0.03))
    matched = alike * (torch.cdist(coarsest, others).square() < 100)
    flow = matched @ others / (matched.sum(dim=2, keepdim=True) + 1e-8) - coarsest
    flow = _upsample(flow, coarsest, sixteenth).transpose(1, 2)
    flow = _set_conv(layer.sa1, sixteenth, flow, sixteenth.shape[1])[1]
    flow = _upsample(flow.transpose(1, 2), sixteenth, eighth).transpose(1, 2)
    flow = _set_conv(layer.sa2, eighth, flow, eighth.shape[1])[1]
    return _upsample(flow.transpose(1, 2), eighth, quarter).transpose(1, 2)


def _upsample(values: Tensor, points: Tensor, queries: Tensor) -> Tensor:
    """Interpolate (B, N, C) from points to queries, weighted by inverse distance."""
    far, index = _near(queries, points, 3)
    inverse = 1.0 / far.clamp(min=NEAREST_M)
    weights = inverse / inverse.sum(dim=2, keepdim=True)
    carried = gather_features(values.transpose(1, 2), index) * weights[:, None]
    return carried.sum(dim=3).transpose(1, 2)


def _embed(
    net: FlowStep3D, moved: Tensor, features: Tensor, others: Tensor, other_features: Tensor
) -> Tensor:
    layer = net.local_corr_layer
    far, index = _near(moved, others, layer.neighbours)
    index = torch.where(far > layer.radius_m, index[:, :, :1], index)
    way = gather_features(others.transpose(1, 2), index) - moved.transpose(1, 2)[:, :, :, None]
    own = features[:, :, :, None].expand(-1, -1, -1, index.shape[2])
    return _describe(layer, torch.cat((way, gather_features(other_features, index), own), dim=1))
