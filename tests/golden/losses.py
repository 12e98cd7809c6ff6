"""Checks of the published training losses and their gradients."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from tests.golden.difference import Difference, relative, same, to_scale
from tests.golden.files import arrays, document
from workers.lab.training.elevation_loss import (
    DATA_WEIGHT,
    SMOOTHNESS_WEIGHT,
    elevation_loss,
    second_order_smoothness,
)
from workers.lab.training.flow_loss import (
    FINE_TUNING,
    PRE_TRAINING,
    FlowLossSettings,
    ball_neighbours,
    flow_loss,
    nearest_neighbours,
)
from workers.lab.training.loss import lovasz_softmax, segmentation_loss

VALUE: Final = 1e-5
"""Relative tolerance of a loss."""
GRADIENT: Final = 1e-4
"""Tolerance of a gradient, to the largest."""


def check_segmentation(folder: Path, file: Path) -> list[Difference]:
    """Compare weighted log loss plus Lovász-softmax of each network and data set."""
    del folder
    golden = arrays(file)
    differences = []
    for case, expected in document(file.with_suffix(".json")).items():
        logits = torch.from_numpy(golden[f"{case}_logits"]).requires_grad_()
        labels = torch.from_numpy(golden[f"{case}_labels"].astype(np.int64))
        loss = segmentation_loss(logits, labels, torch.tensor(expected["weights"]))
        lovasz = lovasz_softmax(torch.softmax(logits, dim=1), labels).item()
        (gradient,) = torch.autograd.grad(loss, logits)
        wanted = golden[f"{case}_gradient_logits"]
        differences += [
            relative(f"{case} total", loss.item(), expected["total"], tolerance=VALUE),
            relative(f"{case} lovasz", lovasz, expected["lovasz"], tolerance=VALUE),
            to_scale(f"{case} gradient", gradient.numpy(), wanted, tolerance=GRADIENT),
        ]
    return differences


def check_flow(folder: Path, file: Path) -> list[Difference]:
    """Compare FlowStep3D's loss, its parts and its gradient under both published settings."""
    del folder
    golden, listed = arrays(file), document(file.with_suffix(".json"))
    points = torch.from_numpy(golden["points1"])
    first = golden["ball_query_r075_k64_first_point_indices"]
    ball = ball_neighbours(points, first.shape[1], radius_m=0.75)[: len(first)]
    knn = nearest_neighbours(points, 16, radius_m=float("inf"))[: len(first)]
    return [
        same("ball neighbours", ball.numpy(), first),
        same("nearest neighbours", knn.numpy(), golden["knn16_first_point_indices"]),
        *_flow(golden, "pretrain", listed["flowstep3d_self_pre"], PRE_TRAINING),
        *_flow(golden, "finetune", listed["flowstep3d_self_ft"], FINE_TUNING),
    ]


def _flow(
    golden: Mapping[str, NDArray[Any]], name: str, expected: Any, settings: FlowLossSettings
) -> list[Difference]:
    flows = torch.from_numpy(golden["flow_iterates"]).requires_grad_()
    total, parts = flow_loss(
        torch.from_numpy(golden["points1"]),
        torch.from_numpy(golden["points2"]),
        flows.unbind(),
        settings,
    )
    (gradient,) = torch.autograd.grad(total, flows)
    found = [
        relative(
            f"{name} {part}",
            [getattr(each, part).item() for each in parts],
            [each[part] for each in expected["per_iterate"]],
            tolerance=VALUE,
        )
        for part in ("chamfer", "knn_smoothness", "ball_smoothness", "loss")
    ]
    wanted = golden[f"gradient_of_total_{name}"]
    return [
        same(f"{name} settings", _listed(settings), _published(expected)),
        *found,
        relative(f"{name} total", total.item(), expected["total"], tolerance=VALUE),
        to_scale(f"{name} gradient", gradient.numpy(), wanted, tolerance=GRADIENT),
    ]


def _listed(settings: FlowLossSettings) -> list[float]:
    return [
        *(*settings.iterate, *settings.data, *settings.smoothness),
        *(settings.knn_weight, settings.knn_neighbours, settings.knn_radius_m),
        *(settings.ball_weight, settings.ball_neighbours, settings.ball_radius_m),
    ]


def _published(listed: Any) -> list[float]:
    loss = listed["loss"]
    smooth = loss["smoothness_loss_params"]
    knn, ball = smooth["knn_loss_params"], smooth["ball_q_loss_params"]
    return [
        *(*listed["loss_iters_w"], *loss["w_data"], *loss["w_smoothness"]),
        *(smooth["w_knn"], knn["k"], knn["radius"]),
        *(smooth["w_ball_q"], ball["k"], ball["radius"]),
    ]


def check_elevation(folder: Path, file: Path) -> list[Difference]:
    """Compare GndNet's loss and its gradient."""
    del folder
    golden = arrays(file)
    drawn = torch.from_numpy(golden["prediction"]).requires_grad_()
    truth = torch.from_numpy(golden["label"])
    close = torch.nn.functional.smooth_l1_loss(drawn, truth).item()
    smooth = second_order_smoothness(drawn).item()
    loss = elevation_loss(drawn, truth)
    (gradient,) = torch.autograd.grad(loss, drawn)
    return [
        same("alpha_beta", [DATA_WEIGHT, SMOOTHNESS_WEIGHT], golden["alpha_beta"]),
        relative("smooth_l1_mean", close, golden["smooth_l1_mean"], tolerance=VALUE),
        relative("spatial_smoothness", smooth, golden["spatial_smoothness"], tolerance=VALUE),
        relative("total", loss.item(), golden["total"], tolerance=VALUE),
        to_scale("gradient", gradient.numpy(), golden["gradient_of_total"], tolerance=GRADIENT),
    ]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "losses/segmentation_loss.npz": check_segmentation,
    "losses/flowstep3d_loss.npz": check_flow,
    "losses/gndnet_loss.npz": check_elevation,
}
