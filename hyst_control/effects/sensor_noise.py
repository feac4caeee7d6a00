"""More white noise than the model states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from hyst_control.chain.stage import Array, Filter, Sampling, register
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.random_stages import NoiseFilter, RandomStage, check_noise, noise_level


@register
@dataclass(frozen=True)
class SensorNoise(RandomStage):
    """White Gaussian noise of `rms` (measurement unit) on every sample and axis, from a generator with `seed`."""

    name: ClassVar[str] = "sensor_noise"
    rms: Any
    seed: int = 0

    def check(self) -> None:
        check_noise(self)

    def filter(self, sampling: Sampling) -> Filter:
        return WhiteFilter(noise_level(self, sampling), self.seed, sampling.hold)


class WhiteFilter(NoiseFilter):
    """Streaming `SensorNoise`."""

    def draw(self, count: int) -> Array:
        return self.generator.standard_normal((count, len(self.rms)))


EFFECT = Effect(
    "sensor_noise",
    "adc",
    "The measurement has more white noise than the model states.",
    lambda around: (Parameter("rms", "unit", 0.0, (0.002 * around.stroke,), 0.0, 0.2 * around.stroke, 0.01 * around.stroke),),
    lambda values, around: SensorNoise(values["rms"], values.get("seed", 0)),
    waveform=False,
)
