# SPDX-License-Identifier: BSD-3-Clause
"""The pose prior given on the command line, as settings of the registration."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from magmatch.cli.option_values import numbers, refuse
from magmatch.errors import ConfigurationError

if TYPE_CHECKING:
    from magmatch.registration.config import RegistrationConfig


def with_prior(
    config: "RegistrationConfig",
    pose: str | None,
    pose_sd: str | None,
    is_aligned: bool,
    gravity_sd: float | None,
    is_planar: bool,
) -> "RegistrationConfig":
    """Put the pose prior into the settings."""
    from math import radians

    said: dict[str, Any] = {}
    if pose is not None:
        said["pose"] = _pose(pose)
    if pose_sd is not None:
        if pose is None and config.prior.pose is None:
            msg = "--prior-pose-sd: there is no rough pose; give --prior-pose too"
            raise ConfigurationError(msg)
        metres, degrees = numbers("--prior-pose-sd", pose_sd, 2, "metres,degrees, both above 0, such as 1,10")
        if metres <= 0 or not 0 < degrees <= 180:
            refuse("--prior-pose-sd", "metres above 0 and degrees from 0 to 180", pose_sd)
        said |= {"sd_translation": metres, "sd_rotation": radians(degrees)}
    known = is_aligned or is_planar or config.prior.is_gravity_aligned or config.prior.is_planar
    if gravity_sd is not None and not known:
        msg = "--gravity-sd: give --gravity-aligned or --planar too"
        raise ConfigurationError(msg)
    said |= {"is_gravity_aligned": True} if is_aligned else {}
    said |= {"is_planar": True} if is_planar else {}
    said |= {} if gravity_sd is None else {"gravity_sd": radians(gravity_sd)}
    if not said:
        return config
    if config.search == "keypoints":
        msg = "--prior-pose, --gravity-aligned and --planar: these settings search by keypoints, which use no prior"
        raise ConfigurationError(msg)
    return type(config).model_validate(config.model_dump() | {"prior": config.prior.model_dump() | said})


def _pose(text: str) -> tuple[float, ...]:
    """Seven numbers, as given or from a result."""
    if "," not in text or Path(text).is_file():
        return _pose_of(Path(text))
    x, y, z, *q = numbers("--prior-pose", text, 7, "x,y,z,qx,qy,qz,qw (m; a unit quaternion) or a result's file")
    norm = sum(c * c for c in q) ** 0.5
    if not 0.99 < norm < 1.01:
        msg = f"--prior-pose: expected a unit quaternion qx,qy,qz,qw, found one of length {norm:.3g}"
        raise ConfigurationError(msg)
    return (x, y, z, *(c / norm for c in q))


def _pose_of(path: Path) -> tuple[float, ...]:
    """Pose of a result, or its best candidate if it was not accepted."""
    from magmatch.cli.inputs import read_result

    result = read_result(path)
    considered = (result.T_base_target, *(a.T_base_target for a in result.alternatives))
    T = next((T for T in considered if T is not None), None)
    if T is None:
        msg = f"--prior-pose: {path} holds no pose, accepted or not"
        raise ConfigurationError(msg)
    return (*map(float, T.translation), *map(float, T.rotation.as_quat()))
