"""Depth sensors by name: the ideal one, structured light, and stereo."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.sensor import DepthSensor
from pointsdf_cli.choices import Sensor, require_choice

SENSORS: Mapping[str, DepthSensor] = MappingProxyType(
    {
        sensor.name: sensor
        for sensor in (
            # The paper's: Gaussian noise of 1 mm at 1.5 m.
            DepthSensor("ideal", noise=DepthNoise()),
            # Asus Xtion, Kinect 1; shares fitted by benchmarks/sensor_errors.py.
            DepthSensor(
                "structured-light",
                focal=575.0,
                baseline=0.075,
                # Registered to a colour camera that stands between imager and projector.
                shadow_left=0.045,
                shadow_right=0.03,
                displacement=0.87,
                displacement_window=5.0,
                registration=1.5,
                registration_window=58.0,
                edge_slope=8.0,
                missing_at_edge=0.33,
                missing_reach=1.35,
                missing_patches=0.004,
                patch_window=20.0,
                missing_grazing=0.17,
                missing_angle=1.4,
                missing_window=2.5,
                flying=0.18,
                quantisation=1 / 24,
                axial_floor=0.0006,
                axial_depth=0.0009,
                axial_incidence=4e-5,
                noise_window=1.5,
                bias=0.0007,
            ),
            # Intel RealSense D415, D435, registered to the colour camera.
            DepthSensor(
                "stereo",
                focal=615.0,
                baseline=0.05,
                shadow_left=0.065,
                displacement=1.2,
                displacement_window=6.0,
                registration=0.7,
                registration_window=60.0,
                fattening=1.0,
                matching_window=12.0,
                missing_at_edge=0.2,
                missing_reach=1.0,
                missing_patches=0.002,
                patch_window=10.0,
                missing_grazing=0.5,
                missing_angle=1.35,
                missing_window=2.0,
                flying=0.3,
                quantisation=1 / 32,
                axial_incidence=7e-5,
                disparity_noise=0.1,
                noise_window=8.0,
                bias=0.003,
                bias_window=60.0,
            ),
        )
    }
)


def with_sensor_parameters(config: dict[str, Any]) -> dict[str, Any]:
    """Settings for `config_json`, with the sensor's parameters instead of its name."""
    return config | {"sensor": load_sensor(config["sensor"]).as_dict()}


def load_sensor(name: str) -> DepthSensor:
    """Sensor of a preset.

    Raises:
        InputError: There is no preset of this name.
    """
    require_choice(name, Sensor, "--sensor")
    return SENSORS[name]
