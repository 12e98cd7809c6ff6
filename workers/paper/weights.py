"""Weights of the learned parts of the self-supervised stream, with their cards."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from workers.checkpoints import stored_weights
from workers.checkpoints.stored_weights import Card, Stored
from workers.lidar.fidelity import Form
from workers.paper.delora import DeLORA
from workers.paper.flowstep3d import FlowStep3D
from workers.paper.gndnet import GndNet


class GndNetCard(Card):
    """Card of GndNet: parameters of its training."""

    network: Literal["gndnet"] = "gndnet"
    sensor_height_m: float = Field(
        gt=0, description="Of the sensor over the road in training; added to every z."
    )

    def build(self, form: Form = Form.CORRECTED) -> GndNet:
        """Build the network, with random parameters."""
        return GndNet(form=form)


class FlowStep3DCard(Card):
    """Card of FlowStep3D: parameters of its training."""

    network: Literal["flowstep3d"] = "flowstep3d"
    points: int = Field(ge=32, le=1 << 17, description="Size of cloud; level n keeps points / 2^n.")
    neighbours: int = Field(
        ge=1, le=1024, description="Of the other cloud each moved point is compared with."
    )
    radius_m: float = Field(gt=0, description="How far away those may be.")
    decay: float = Field(ge=0, description="Step i of the flow is divided by decay * i + 1.")
    iterates: int = Field(ge=1, le=64, description="How often the flow is estimated.")

    def build(self, form: Form = Form.CORRECTED) -> FlowStep3D:
        """Build the network, with random parameters."""
        return FlowStep3D(
            points=self.points,
            neighbours=self.neighbours,
            radius_m=self.radius_m,
            decay=self.decay,
            form=form,
        )


class DeLORACard(Card):
    """Card of DeLORA: parameters of its training."""

    network: Literal["delora"] = "delora"
    rows: int = Field(ge=16, le=1024, description="Height of the range image.")
    columns: int = Field(ge=64, le=8192, description="Width of the range image.")
    fov_up_deg: float = Field(description="Upper edge of the vertical field of view.")
    fov_down_deg: float = Field(description="Its lower edge, below the horizon negative.")
    refinements: int = Field(
        default=0,
        ge=0,
        le=16,
        description="Estimates of what a motion leaves, beginning with the motion before; 0: one "
        "estimate from the scans as measured, as published.",
    )

    def build(self, form: Form = Form.CORRECTED) -> DeLORA:
        """Build the network, with random parameters."""
        return DeLORA(form=form)


def load_gndnet(path: Path, *, form: Form = Form.CORRECTED) -> Stored[GndNet, GndNetCard]:
    """Load GndNet from a `.safetensors` file and its card in the same folder.

    Raises:
        WeightsUnusableError: If they are missing, damaged or do not fit; no partial load.
    """
    return stored_weights.load(path, GndNetCard, lambda card: card.build(form))


def load_flowstep3d(
    path: Path, *, form: Form = Form.CORRECTED
) -> Stored[FlowStep3D, FlowStep3DCard]:
    """Load FlowStep3D from a `.safetensors` file and its card in the same folder.

    Raises:
        WeightsUnusableError: If they are missing, damaged or do not fit; no partial load.
    """
    return stored_weights.load(path, FlowStep3DCard, lambda card: card.build(form))


def load_delora(path: Path, *, form: Form = Form.CORRECTED) -> Stored[DeLORA, DeLORACard]:
    """Load DeLORA from a `.safetensors` file and its card in the same folder.

    Raises:
        WeightsUnusableError: If they are missing, damaged or do not fit; no partial load.
    """
    return stored_weights.load(path, DeLORACard, lambda card: card.build(form))
