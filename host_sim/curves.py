"""Curves in the plane by their arc length: line, circle, Bernoulli's lemniscate."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from host_sim.trajectory import Array

Complex = NDArray[np.complex128]


class Curve(Protocol):
    """A curve by its arc length."""

    @property
    def length_m(self) -> float:
        """Length of a lap."""

    @property
    def reach_m(self) -> float:
        """Longest piece that is worth trying as one polynomial."""

    def derivatives(self, distance: Array) -> Array:
        """Point and three derivatives by arc length, shape (n, 4, 2), at distances of shape (n,) in m."""


@dataclass(frozen=True)
class Line:
    """From the origin along x1."""

    length_m: float

    @property
    def reach_m(self) -> float:
        """Short enough for the resolution of float32."""
        return self.length_m

    def derivatives(self, distance: Array) -> Array:
        """Point and three derivatives by arc length, shape (n, 4, 2), at distances of shape (n,) in m."""
        result = np.zeros((len(distance), 4, 2))
        result[:, 0, 0] = distance
        result[:, 1, 0] = 1.0
        return result


@dataclass(frozen=True)
class Circle:
    """Centred at the origin, counter-clockwise from (radius, 0)."""

    radius_m: float

    @property
    def length_m(self) -> float:
        """Circumference."""
        return 2.0 * math.pi * self.radius_m

    @property
    def reach_m(self) -> float:
        """A quarter."""
        return self.length_m / 4.0

    def derivatives(self, distance: Array) -> Array:
        """Point and three derivatives by arc length, shape (n, 4, 2), at distances of shape (n,) in m."""
        point = self.radius_m * np.exp(1j * distance / self.radius_m)
        return _as_real([point * (1j / self.radius_m) ** order for order in range(4)])

    def distance(self, points: Array) -> Array:
        """Distance of points to the circle, shape (n,) in m, of points of shape (n, 2) in m."""
        return np.asarray(np.abs(np.hypot(points[:, 0], points[:, 1]) - self.radius_m))

    def outline(self) -> Array:
        """Vertices to draw the circle with, shape (m, 2) in m."""
        return np.asarray(self.derivatives(np.linspace(0.0, self.length_m, 361))[:, 0])


@dataclass(frozen=True)
class Lemniscate:
    """Bernoulli's, centred at the origin, from its right end upwards.

    With a the half width and parameter t: point a cos t / (1 - i sin t) = r exp(iφ), r with sign, φ = atan(sin t);
    arc length ∫ a / √(1 + sin² t) dt; tangent i exp(3iφ); curvature 3 r / a².
    """

    half_width_m: float

    @property
    def length_m(self) -> float:
        """Length of both loops."""
        return float(2.0 * math.pi * self.half_width_m * self._series[0])

    @property
    def reach_m(self) -> float:
        """An eighth, half of it bends."""
        return self.length_m / 8.0

    @cached_property
    def _series(self) -> Array:
        """Fourier coefficients of 1 / √(1 + sin² t) = c0 + Σ ck cos 2kt; they shrink by 0.17 each."""
        samples = 64
        spectrum = np.fft.rfft(1.0 / np.sqrt(1.0 + np.sin(np.pi * np.arange(samples) / samples) ** 2)).real / samples
        return np.concatenate([spectrum[:1], 2.0 * spectrum[1 : samples // 2]])

    def _parameter(self, distance: Array) -> Array:
        """Parameter at arc lengths, both of shape (n,), by Newton's method."""
        order = 2.0 * np.arange(1, len(self._series))
        target = distance / self.half_width_m
        parameter = np.asarray(target / self._series[0])
        for _ in range(6):  # the error is at most 0.1 at first and squares each time
            waves = np.sin(np.multiply.outer(parameter, order)) @ (self._series[1:] / order)
            parameter -= (self._series[0] * parameter + waves - target) * np.sqrt(1.0 + np.sin(parameter) ** 2)
        return parameter

    def _at(self, parameter: Array) -> tuple[Complex, Complex, Array]:
        """Point, tangent and curvature, each of shape (n,), at parameters of shape (n,)."""
        point = self.half_width_m * np.cos(parameter) / (1.0 - 1j * np.sin(parameter))
        direction = (1.0 + 1j * np.sin(parameter)) / np.sqrt(1.0 + np.sin(parameter) ** 2)
        curvature = 3.0 * (point / direction).real / self.half_width_m**2
        return point, 1j * direction**3, curvature

    def derivatives(self, distance: Array) -> Array:
        """Point and three derivatives by arc length, shape (n, 4, 2), at distances of shape (n,) in m."""
        parameter = self._parameter(distance)
        point, tangent, curvature = self._at(parameter)
        bending = -3.0 * np.sin(2.0 * np.arctan(np.sin(parameter))) / self.half_width_m**2  # dκ/ds
        return _as_real([point, tangent, 1j * curvature * tangent, (1j * bending - curvature**2) * tangent])

    def distance(self, points: Array) -> Array:
        """Distance of points to the lemniscate, shape (n,) in m, of points of shape (n, 2) in m.

        Exact for points nearer than the smallest radius, a third of the half width; else good to a millimetre.
        """
        batches = np.array_split(points[:, 0] + 1j * points[:, 1], 1 + len(points) // 2048)
        return np.concatenate([np.minimum(self._distance(b, 0.0), self._distance(b, np.pi)) for b in batches])

    def _distance(self, points: Complex, start: float) -> Array:
        """Distance of points of shape (n,) to half of the curve, so that it does not meet itself, from a parameter on.

        The nearest of a grid is improved by Newton's method.
        """
        grid = start + np.linspace(0.0, np.pi, 257)
        gap = np.abs(points[:, None] - self._at(grid)[0])
        parameter, nearest = grid[np.argmin(gap, axis=1)], np.min(gap, axis=1)
        for _ in range(4):
            point, tangent, curvature = self._at(parameter)
            offset = (point - points) * tangent.conj()  # along and across the tangent
            step = offset.real / np.maximum(1.0 + curvature * offset.imag, 0.1)
            parameter = parameter - step * np.sqrt(1.0 + np.sin(parameter) ** 2) / self.half_width_m
        return np.asarray(np.minimum(nearest, np.abs(points - self._at(parameter)[0])))

    def outline(self) -> Array:
        """Vertices to draw the lemniscate with, shape (m, 2) in m."""
        return np.asarray(self.derivatives(np.linspace(0.0, self.length_m, 361))[:, 0])


def _as_real(columns: list[Complex]) -> Array:
    """Shape (n, k, 2) of k complex columns of shape (n,)."""
    stacked = np.stack(columns, axis=1)
    return np.stack([stacked.real, stacked.imag], axis=-1)
