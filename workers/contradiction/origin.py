"""Origin of a scene: log, lidar, vehicle and software."""

from dataclasses import dataclass

from schemas.work import Shard


@dataclass(frozen=True, slots=True)
class Origin:
    """Log, lidar, vehicle and software of a scene, as its record names them."""

    log_id: str
    lidar_topic: str
    vehicle: str
    date: str
    software_version: str

    @classmethod
    def of(cls, shard: Shard) -> "Origin":
        """Return the origin of the scenes of a shard."""
        return cls(
            log_id=shard.log_id,
            lidar_topic=shard.lidar.topic,
            vehicle=shard.vehicle,
            date=shard.date,
            software_version=shard.software_version,
        )
