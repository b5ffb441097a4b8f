"""Depth sensors named after devices; their error curves are published measurements or formulas.

Total random error is the standard deviation of a pixel's depth on a wall that faces the sensor, quantisation included:
noise and quantisation are independent, and rounding to steps of length s has a standard deviation of s / sqrt(12).

- `kinect-v1`: 1.425 mm at 1 m, growing with the square of depth: half a unit of disparity (Khoshelham and Elberink
  2012, Sensors 12(2), 1437-1454: 4 cm at 5 m). Depth comes in steps of 2.85 mm at 1 m, 7 cm at 5 m. Range 0.5 to 5 m.
- `azure-kinect`: 17 mm at 3.5 m, the upper bound that Microsoft states and Toelgyessy et al. 2021 (Sensors 21(2), 413)
  confirm for all modes, growing with the square of depth, as the light that returns falls with it. A single device in
  its narrow modes is usually better. Whole millimetres, range 0.5 to 3.86 m (narrow field of view, unbinned). The
  systematic error (below 11 mm in the same sources) is left out.
- `realsense-d435`: z^2 x subpixel / (focal length x baseline), Intel's formula (Grunnet-Jepsen, Sweetser and Woodfill,
  Tuning depth cameras for best performance), for 848 pixels at 90 degrees, a baseline of 50 mm and the 0.08 pixels that
  its authors recommend: 3.77 mm at 1 m. Disparity in 1/32 pixel. Range 0.17 to 10 m.
"""

import dataclasses
import math

from datagen.config import Recipe, Sensor
from datagen.errors import unknown_name

_D435_FOCAL, _D435_BASELINE = 0.5 * 848 / math.tan(math.radians(45)), 0.05

TOTAL_NOISE = {
    "kinect-v1": 0.001425,
    "azure-kinect": 0.017 / 3.5**2,
    "realsense-d435": 0.08 / (_D435_FOCAL * _D435_BASELINE),
}
"""Total random error at 1 m, metres; it grows with the square of depth."""

_STEPS = {"kinect-v1": 0.00285, "azure-kinect": 0.0, "realsense-d435": 1 / (32 * _D435_FOCAL * _D435_BASELINE)}
"""Depth step at 1 m, metres."""


def _sensor(device: str, *, nearest: float, farthest: float, depth_step: float = 0.0) -> Sensor:
    noise = math.sqrt(TOTAL_NOISE[device] ** 2 - _STEPS[device] ** 2 / 12)
    return Sensor(
        enabled=True,
        axial_noise=round(noise, 7),
        quantisation=round(_STEPS[device], 7),
        device=device,
        depth_step=depth_step,
        nearest=nearest,
        farthest=farthest,
    )


SENSORS = {
    "kinect-v1": _sensor("kinect-v1", nearest=0.5, farthest=5.0),
    "azure-kinect": _sensor("azure-kinect", nearest=0.5, farthest=3.86, depth_step=0.001),
    "realsense-d435": _sensor("realsense-d435", nearest=0.17, farthest=10.0),
}
"""Constants of each device's sensor."""


def with_sensor(recipe: Recipe, device: str) -> Recipe:
    """The recipe with a device's depth sensor.

    Raises:
        UsageError: there is no such preset.
    """
    if device not in SENSORS:
        raise unknown_name("sensor", device, SENSORS)
    return dataclasses.replace(recipe, sensor=SENSORS[device])
