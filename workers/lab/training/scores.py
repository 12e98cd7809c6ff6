"""Validation scores of a network: intersection over union on held-out images."""

import numpy as np
import torch

from workers.lab.datasets.images import TrainingImages
from workers.lab.evaluation.semantics.confusion import class_iou, joint_iou
from workers.lab.training.augment import Sample, network_input
from workers.supervised.salsanext import SalsaNext
from workers.supervised.weights import WeightsCard


def score_images(
    net: SalsaNext,
    images: TrainingImages,
    card: WeightsCard,
    *,
    proved: bool = False,
    device: str = "cpu",
) -> dict[str, float]:
    """Return the IoU of each class over pixels that show a labelled point.

    Args:
        net: The network; set to evaluation mode.
        images: Held-out images.
        card: Names of the classes and the normalisation.
        proved: Classes are those of a `TrainingSet` that is `proved`: only movable ones count.
        device: Device of the network.

    Returns:
        IoU per class present; for semantics also of all movable classes merged into one.
    """
    net.eval()
    truth = images.semantic if card.network == "salsanext" else images.motion
    movable = np.array([meaning.movable for meaning in card.classes])
    grouped = proved and card.network == "salsanext"
    classes = 3 if grouped else len(card.classes)
    confusion = np.zeros((classes, classes), dtype=np.int64)
    for number, labels in enumerate(truth):
        residuals = images.residuals[number, 0] if card.residual else images.residuals[0, 0, :0]
        sample = Sample(
            images.channels[number].astype(np.float32),
            residuals.astype(np.float32),
            images.seen_mask[number],
            labels,
        )
        x = torch.from_numpy(network_input(sample, card.profile, card.channels))[None]
        with torch.inference_mode():
            shares = net(x.to(device).contiguous(memory_format=torch.channels_last))[0].cpu()
        found = shares[1:].argmax(0).numpy() + 1  # class 0 is not trained and never wins
        if grouped:
            found = 1 + movable[found]
        counted = labels > 0
        np.add.at(confusion, (labels[counted], found[counted]), 1)
    if grouped:
        return {"movable": joint_iou(confusion, np.array([False, False, True])) or 0.0}
    scores = class_iou(confusion, [meaning.name for meaning in card.classes])
    if movable.any():
        scores["movable"] = joint_iou(confusion, movable) or 0.0
    return scores
