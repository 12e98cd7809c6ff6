"""Builds each replaceable part, and imports what it is made of only when it is chosen.

Every import is within a function, so that the service can read the catalogue without torch, and an
import statement, so that the pipeline version finds the code (`workers.sources`).
"""

from pathlib import Path
from typing import TYPE_CHECKING

from schemas.task import MOTION, Task
from workers.errors import UnknownPartError
from workers.parts.files import PartFiles

if TYPE_CHECKING:
    from schemas.motion_rule import MotionRule
    from workers.checkpoints.stored_weights import Card
    from workers.contradiction.settings import InstanceSettings
    from workers.parts.protocols import Odometry, Stream, Witness


def kiss_icp(_: PartFiles) -> "Odometry":
    """Build KISS-ICP."""
    from workers.odometry.odometry import KissOdometry

    return KissOdometry()


def delora(files: PartFiles) -> "Odometry":
    """Load the published odometry network."""
    from workers.paper.delora_odometry import DeLORAOdometry

    return DeLORAOdometry.load(Path(files.weights))


def salsanext_lmnet(files: PartFiles, *, published: bool = False) -> "Stream":
    """Load the two networks over range images, from the named folder or those that ship."""
    from workers.checkpoints.devices import device_of
    from workers.lidar.fidelity import Form
    from workers.supervised.stream import SHIPPED, RangeImageStream

    folder = Path(files.weights) if files.weights else SHIPPED
    form = Form.PAPER if published else Form.CORRECTED
    return RangeImageStream.salsanext_lmnet(folder, form=form, device=device_of(files.device))


def salsanext_ground(files: PartFiles) -> "Stream":
    """Load the semantic network for the task ground."""
    from workers.checkpoints.devices import device_of
    from workers.supervised.stream import SHIPPED, RangeImageStream

    folder = Path(files.weights) if files.weights else SHIPPED
    return RangeImageStream.salsanext_ground(folder, device=device_of(files.device))


def own(files: PartFiles) -> "Stream":
    """Open the user's own model by its adapter.

    Raises:
        UnknownPartError: If the settings name no adapter.
    """
    from workers.supervised.own_model import open_own_model

    if not files.model:
        raise UnknownPartError("supervised stream 'own' needs the setting model: an adapter.toml")
    return open_own_model(Path(files.model))


def recorded(_: PartFiles, *, task: Task = MOTION) -> "Stream":
    """Build the stream of labels recorded in the log."""
    from workers.supervised.recorded import Recorded

    return Recorded(task)


def registration(_: PartFiles, *, lookahead_s: float = 0.0) -> "Stream":
    """Build the default stream; its loops compile in a process of their own meanwhile."""
    from workers.selfsupervised.stream import Registration
    from workers.warmup.jit_warmup import compile_in_child

    compile_in_child()
    return Registration(lookahead_s)


def nearest_neighbour(files: PartFiles, *, published: bool = False) -> "Stream":
    """Build the two-stage rule on the flow to the nearest point."""
    from workers.paper.scene_flow import nearest_neighbour_flow
    from workers.paper.two_stage import TwoStage

    rule = _motion_rule(files, published=published)
    return TwoStage("nearest-neighbour", nearest_neighbour_flow, rule)


def registered_clusters(files: PartFiles, *, published: bool = False) -> "Stream":
    """Build the two-stage rule on the flow of registered clusters."""
    from workers.paper.rigid_flow import rigid_flow
    from workers.paper.two_stage import TwoStage

    return TwoStage("registered-clusters", rigid_flow, _motion_rule(files, published=published))


def flowstep3d(files: PartFiles, *, published: bool = False) -> "Stream":
    """Load FlowStep3D and build the two-stage rule on its flow."""
    from workers.paper.learned_flow import FlowStep3DFlow
    from workers.paper.two_stage import TwoStage

    flow = FlowStep3DFlow.load(Path(files.weights))
    rule = _motion_rule(files, published=published)
    return TwoStage("flowstep3d", flow, rule, flow.version)


def _motion_rule(files: PartFiles, *, published: bool) -> "MotionRule":
    """Return the thresholds of the setting `motion_rule`, else the published ones."""
    from schemas.motion_rule import PAPER, PER_SECOND, MotionRule

    if files.motion_rule:
        return MotionRule.model_validate_json(files.motion_rule)
    return PAPER if published else PER_SECOND


def tracked(files: PartFiles, *, published: bool = False) -> "Stream":
    """Build the two-stage rule on velocities that the default stream proved."""
    from workers.paper.two_stage_tracked import TrackedTwoStage

    return TrackedTwoStage(_motion_rule(files, published=published))


def paper(files: PartFiles) -> "Stream":
    """Load the published chain."""
    from workers.paper.paper_chain import PaperChain

    return PaperChain.load(Path(files.weights))


def ground(_: PartFiles) -> "Stream":
    """Build the ground stream."""
    from workers.selfsupervised.ground_stream import GroundStream

    return GroundStream()


def free_space(_: PartFiles) -> "Witness":
    """Build the free-space witness."""
    from workers.witness.free_space import TwoSidedFreeSpace

    return TwoSidedFreeSpace()


def no_witness(_: PartFiles) -> "Witness":
    """Build the witness that leaves frames unchanged."""
    from workers.parts.protocols import NoWitness

    return NoWitness()


def default_instances(_: PartFiles) -> "InstanceSettings":
    """Return the default rule of instances."""
    from workers.contradiction.settings import DEFAULT_INSTANCES

    return DEFAULT_INSTANCES


def paper_instances(_: PartFiles) -> "InstanceSettings":
    """Return the published rule of instances."""
    from workers.contradiction.settings import PAPER_INSTANCES

    return PAPER_INSTANCES


def card_over_images(_: PartFiles) -> "type[Card]":
    """Return the card of SalsaNext and LMNet."""
    from workers.supervised.weights import WeightsCard

    return WeightsCard


def gndnet_card(_: PartFiles) -> "type[Card]":
    """Return the card of GndNet."""
    from workers.paper.weights import GndNetCard

    return GndNetCard


def flowstep3d_card(_: PartFiles) -> "type[Card]":
    """Return the card of FlowStep3D."""
    from workers.paper.weights import FlowStep3DCard

    return FlowStep3DCard


def delora_card(_: PartFiles) -> "type[Card]":
    """Return the card of DeLORA."""
    from workers.paper.weights import DeLORACard

    return DeLORACard
