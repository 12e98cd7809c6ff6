"""Checks of the networks: published names, recipe parameters, published outputs."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from tests.golden.difference import Difference, near, quantile, same
from tests.golden.files import Arrays, arrays, document, number_of, parameters, present
from workers.checkpoints.parameter_loading import load_into
from workers.checkpoints.published import read_checkpoint
from workers.lidar.fidelity import Form
from workers.paper.delora import DeLORA
from workers.paper.flowstep3d import FlowStep3D
from workers.paper.gndnet import GndNet
from workers.paper.pillars import Pillars, pillars
from workers.supervised.lmnet import LMNet
from workers.supervised.salsanext import SalsaNext

CLEAR = 1e-5
"""Where the two best classes differ by less, rounding decides which is best."""

CHECKPOINT: Final = "flowstep3d_movingdetect_epoch79.ckpt"


def check_salsanext(folder: Path, file: Path) -> list[Difference]:
    """Compare SalsaNext, of the channels, classes and width that the folder's parameters have."""
    shape = parameters(folder, "salsanext")
    width, channels = shape["downCntx.conv1.weight"].shape[:2]
    classes = shape["logits.weight"].shape[0]
    net = SalsaNext(in_channels=channels, classes=classes, width=width)
    return _range_image_network(folder, file, "salsanext", net)


def check_lmnet(folder: Path, file: Path) -> list[Difference]:
    """Compare LMNet, of the residuals and width that the folder's parameters have."""
    width, channels = parameters(folder, "lmnet")["downCntx.conv1.weight"].shape[:2]
    return _range_image_network(folder, file, "lmnet", LMNet(residuals=channels - 5, width=width))


def _range_image_network(folder: Path, file: Path, name: str, net: SalsaNext) -> list[Difference]:
    golden, named = arrays(file), _filled(folder, name, net)
    with torch.inference_mode():
        logits = net.forward_logits(torch.from_numpy(golden["input"]))
        shares = torch.softmax(logits, dim=1).numpy()
    second, first = np.sort(shares, axis=1)[:, -2:].swapaxes(0, 1)
    clear = first - second > CLEAR
    found = [
        *named,
        near("softmax", shares, golden["softmax"], tolerance=1e-5),
        same("argmax where clear", shares.argmax(axis=1)[clear], golden["argmax"][clear]),
    ]
    if "logits" in golden:
        found.append(near("logits", logits.numpy(), golden["logits"], tolerance=5e-5))
    return found


def check_delora(folder: Path, file: Path) -> list[Difference]:
    """Compare DeLORA, batches included."""
    net = DeLORA(form=Form.PAPER)
    golden, named = arrays(file), _filled(folder, "delora", net)
    image, next_image = (torch.from_numpy(golden[name]) for name in ("image1", "image2"))
    with torch.inference_mode():
        motion = net(image, next_image)
        features = net.resnet(torch.cat((image, next_image), dim=1))
    found = {
        "translation": motion.translation_m,
        "quaternion_xyzw": motion.quaternion_xyzw,
        "transformation": motion.this_from_next,
        "resnet_output": features,
    }
    return [
        *named,
        *(near(what, got.numpy(), golden[what], tolerance=1e-5) for what, got in found.items()),
    ]


def check_gndnet(folder: Path, file: Path) -> list[Difference]:
    """Compare GndNet in both forms.

    Cells without points are ties in the pooling, which rounding decides: on made-up dense clouds
    the numbers are compared in float64, elsewhere most cells are.
    """
    golden = arrays(file)
    dense = "points" in golden
    points = golden["points"] if dense else _points(folder, number_of(file))
    cut = pillars(points[:, :3], points[:, 3])
    modes = {
        "elevation_eval_yx": Form.CORRECTED,
        "elevation_train_mode_yx": Form.PAPER,
    }
    net, found = GndNet(), list[Difference]()
    for what, form in modes.items():
        net = GndNet(form=form)
        found += _filled(folder, "gndnet", net)
        got, expected = _elevation(net, cut), golden[what]
        if dense:
            exact = _elevation(net.double(), cut)
            net.float()
            found.append(near(f"{what} in float64", exact, expected, tolerance=1e-4))
        if dense or form is Form.PAPER:
            found += _mostly(what, got, expected, median=1e-3, most=0.05)
        else:
            found.append(quantile(what, got, expected, share=0.97, tolerance=1e-4))
            found.append(near(what, got, expected, tolerance=0.05))
    if "pillar_encoding_float16_hint" in golden:
        hint = golden["pillar_encoding_float16_hint"]
        with torch.inference_mode():
            encoded = net.voxel_feature_extractor(*_tensors(cut, torch.float32)).numpy()
        rounding = float(np.spacing(np.abs(hint).max())) / 2 + 2e-5
        found.append(near("pillar encoding", encoded, hint, tolerance=rounding))
    return found


def _points(folder: Path, number: int) -> np.ndarray[Any, Any]:
    return arrays(folder / "geometry" / f"range_projection_{number:06d}.npz")["points"]


def _elevation(net: nn.Module, cut: Pillars) -> np.ndarray[Any, Any]:
    kind = next(net.parameters()).dtype
    with torch.inference_mode():
        elevation: Tensor = net(*_tensors(cut, kind))
    return elevation.numpy()


def _tensors(cut: Pillars, kind: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    return (
        torch.from_numpy(cut.points).to(kind),
        torch.from_numpy(cut.counts).long(),
        torch.from_numpy(cut.coordinates_zyx).long(),
    )


def check_flowstep3d(folder: Path, file: Path) -> list[Difference]:
    """Compare FlowStep3D with the recipe's parameters."""
    said = document(folder / "networks" / "flowstep3d_parameters.json")
    given = said["model_arguments"]
    net = FlowStep3D(
        points=given["npoint"],
        neighbours=given["loc_flow_nn"],
        radius_m=given["loc_flow_rad"],
        decay=given["k_decay_fact"],
        form=Form.PAPER,
    )
    golden, named = arrays(file), _filled(folder, "flowstep3d", net)
    flows, inner = _flows(net, golden)
    found = [*named, *_sampled(net, golden)]
    found += [
        near(f"flow iterate {i}", flow, expected, tolerance=1e-4)
        for i, (flow, expected) in enumerate(zip(flows, golden["flow_iterates"], strict=True))
    ]
    return found + [
        near(what, got, golden[what], tolerance=1e-4)
        for what, got in inner.items()
        if what in golden
    ]


def check_flowstep3d_checkpoint(folder: Path, file: Path) -> list[Difference]:
    """Compare FlowStep3D with a real checkpoint on two real frames; it amplifies rounding."""
    net = FlowStep3D(form=Form.PAPER)
    stored = read_checkpoint(present(folder / "networks" / CHECKPOINT))
    load_into(net, stored, source=CHECKPOINT)
    golden = arrays(file)
    flows, _ = _flows(net.eval(), golden)
    first, *later = zip(flows, golden["flow_iterates"], strict=True)
    found = [
        _named(stored, list(net.state_dict())),
        *_sampled(net, golden),
        near("flow iterate 0", *first, tolerance=1e-4),
    ]
    for i, (flow, expected) in enumerate(later, start=1):
        what = f"flow iterate {i}"
        found += _mostly(what, flow, expected, median=1e-3, most=0.1)
        found.append(near(what, flow, expected, tolerance=0.3))
    return found


def _flows(
    net: FlowStep3D, golden: Arrays
) -> tuple[list[np.ndarray[Any, Any]], dict[str, np.ndarray[Any, Any]]]:
    """Estimate the flow, and keep what single parts of the network said."""
    heard: dict[str, list[Tensor]] = {}
    parts = ("encoder_loc", "flow0_regressor", "flow_regressor", "h0_net", "gru")
    hooks = [
        net.get_submodule(part).register_forward_hook(
            lambda _module, _inputs, said, part=part: heard.setdefault(part, []).append(said)
        )
        for part in parts
    ]
    clouds = (torch.from_numpy(golden[name])[None] for name in ("points1", "points2"))
    with torch.inference_mode():
        flows = net(*clouds, iterates=len(golden["flow_iterates"]))
    for hook in hooks:
        hook.remove()
    inner = {
        "encoder_loc_features_points1": heard["encoder_loc"][0][0],
        "low_res_flow0": heard["flow0_regressor"][0][0],
        "low_res_delta_before_decay": torch.cat(heard["flow_regressor"]),
        "hidden_before_tanh": heard["h0_net"][0][0, :, ::8],
        "gru_hidden_iter1": heard["gru"][0][0, :, ::8],
    }
    return [flow[0].numpy() for flow in flows], {k: v.numpy() for k, v in inner.items()}


def _sampled(net: FlowStep3D, golden: Arrays) -> list[Difference]:
    found = []
    for which in ("points1", "points2"):
        chosen = net.sample(torch.from_numpy(golden[which])[None])
        for level, index in zip(
            ("level1", "level2", "glob1", "glob2", "glob3"), chosen, strict=True
        ):
            what = f"fps_{which}_{level}"
            found.append(same(what, index[0].numpy(), golden[what]))
    return found


def _mostly(what: str, got: Any, expected: Any, *, median: float, most: float) -> list[Difference]:
    return [
        quantile(what, got, expected, share=0.5, tolerance=median),
        quantile(what, got, expected, share=0.99, tolerance=most),
    ]


def _filled(folder: Path, name: str, net: nn.Module) -> list[Difference]:
    """Fill a network as the recipe says; names, their order and the size are compared."""
    filled = parameters(folder, name)
    named = _named(filled, list(net.state_dict()))
    if not named.holds:
        raise ValueError(f"parameter names differ: {set(filled) ^ set(net.state_dict())}")
    load_into(net, {key: torch.from_numpy(value) for key, value in filled.items()}, source=name)
    net.eval()
    trainable = sum(parameter.numel() for parameter in net.parameters())
    said = document(folder / "networks" / f"{name}_parameters.json")["n_trainable"]
    return [named, same("trainable parameters", trainable, said)]


def _named(given: Mapping[str, object], keys: Sequence[str]) -> Difference:
    differing = len(set(given) ^ set(keys))
    return Difference("parameter names", differing, 0.0, list(given) == list(keys))


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "networks/salsanext_*.npz": check_salsanext,
    "networks/lmnet_*.npz": check_lmnet,
    "networks/gndnet_*.npz": check_gndnet,
    "networks/flowstep3d_checkpoint_*.npz": check_flowstep3d_checkpoint,
    "networks/flowstep3d_*.npz": check_flowstep3d,
    "networks/delora_*.npz": check_delora,
}
