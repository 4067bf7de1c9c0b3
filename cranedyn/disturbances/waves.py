"""Waves, and how a ship answers them: a spectrum, response amplitude operators, and a realisation.

In a long-crested sea the elevation of the water at the origin of the ship is a sum of sines with
random phases εᵢ,

    ζ(t) = Σ aᵢ cos(ωᵢ t + εᵢ),        aᵢ = √(2 S(ωᵢ) Δωᵢ),

with the spectrum S. A ship without speed answers each wave linearly: a coordinate moves by

    Σ |Hᵢ| aᵢ cos(ωᵢ t + εᵢ + δᵢ)

with its response amplitude operator (RAO) H, a complex number for each frequency and heading, of
the magnitude |H| and the phase δ. A positive phase leads the crest of the wave at the origin.

Sources: Hasselmann et al. (1973), Measurements of wind-wave growth and swell decay during the Joint
North Sea Wave Project; DNV-RP-C205, Environmental conditions and environmental loads, §3.5.5; St.
Denis and Pierson (1953), On the motions of ships in confused seas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.checks import finite, number, whole, within
from cranedyn.disturbances.base_motion import COORDINATES, UNITS, BaseMotion, Harmonics, only_column
from cranedyn.errors import DataError, OutOfRange

_WIDTH_BELOW = 0.07
"""Width σ of the peak of a JONSWAP spectrum below the peak frequency, by Hasselmann et al."""

_WIDTH_ABOVE = 0.09
"""Width σ of the peak above the peak frequency."""

_LOWEST_FREQUENCY = 0.4
"""Lowest frequency of a realisation, over that of the peak; there is no energy below."""

_HIGHEST_FREQUENCY = 5.0
"""Highest frequency of a realisation, over that of the peak; above lie 0.2 % of the energy."""

_FINE_STEPS = 4000
"""Intervals of the sum that normalises a spectrum."""

_LARGEST_MISSED_ENERGY = 0.02
"""Largest share of the energy of the waves at frequencies for which there is no RAO."""

_SEEDS = 2**32
"""Number of seeds from which a random sea is drawn."""

_HEADING_TOLERANCE = 1e-6
"""Difference at which two headings are one [°]."""


@dataclass(frozen=True)
class Jonswap:
    """JONSWAP spectrum of the elevation of the sea.

        S(ω) = C ω⁻⁵ exp(-5/4 (ωp/ω)⁴) γ^exp(-½ ((ω - ωp)/(σ ωp))²)

    with the peak frequency ωp = 2π/tp, and σ = 0.07 below and 0.09 above it. The factor C follows
    from the significant height, hs = 4 √∫S dω, by a sum and not by one of the usual approximations.
    With γ = 1 it is the spectrum of Pierson and Moskowitz.

    Attributes:
        hs: Significant wave height [m].
        tp: Peak period [s].
        gamma: Peak enhancement factor γ, 1 to 7; 3.3 is the mean of the measurements.
    """

    hs: float
    tp: float
    gamma: float = 3.3

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If one is not in its range.
        """
        number("significant wave height", self.hs, "m", ">= 0")
        number("peak period", self.tp, "s", "> 0")
        within("peak enhancement factor", self.gamma, 1.0, 7.0)

    @property
    def peak_frequency(self) -> float:
        """Peak frequency ωp [rad/s]."""
        return 2.0 * math.pi / self.tp

    def __call__(self, frequency: np.ndarray) -> np.ndarray:
        """Return the spectral density S at angular frequencies [m² s/rad], of the same shape."""
        edges = _frequencies(self, _FINE_STEPS)
        middles = 0.5 * (edges[:-1] + edges[1:])
        area = float((self._shape(middles) * np.diff(edges)).sum())
        return self.hs**2 / 16.0 / area * self._shape(np.asarray(frequency, dtype=float))

    def _shape(self, frequency: np.ndarray) -> np.ndarray:
        """Return the spectrum but for the factor C."""
        ratio = frequency / self.peak_frequency
        width = np.where(ratio <= 1.0, _WIDTH_BELOW, _WIDTH_ABOVE)
        peak = np.exp(-0.5 * ((ratio - 1.0) / width) ** 2)
        return ratio**-5.0 * np.exp(-1.25 * ratio**-4.0) * self.gamma**peak


@dataclass(frozen=True, eq=False)
class Raos:
    """Response amplitude operators of a ship without speed, for one heading of the waves.

    Attributes:
        frequency: Angular frequencies [rad/s], increasing, shape (k,).
        response: Complex response of each coordinate of
            `cranedyn.disturbances.base_motion.COORDINATES` to the elevation [m/m or rad/m], shape
            (k, 6).
        heading: Direction in which the waves travel, from the ship's X towards its Y [°]: 0 for
            waves from astern of a ship whose bow points along X, 180 for head seas. None if it is
            not known.
    """

    frequency: np.ndarray
    response: np.ndarray
    heading: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            Misshapen: If the arrays do not fit each other.
            OutOfRange: If frequencies are not positive and increasing, or a number is not finite.
        """
        frequency = finite("frequencies of the RAOs", self.frequency, ("k",), unit="rad/s")
        for part in (np.real(self.response), np.imag(self.response)):
            finite("response of the RAOs", part, (len(frequency), len(COORDINATES)))
        if len(frequency) < 2 or not (frequency[0] > 0.0 and (np.diff(frequency) > 0.0).all()):
            allowed = "two or more, positive and increasing"
            raise OutOfRange("frequencies of the RAOs", frequency.tolist(), allowed, "rad/s")

    @classmethod
    def from_file(cls, path: str | Path, heading: float | None = None) -> Raos:
        """Read the operators of one heading from a ``.csv`` or ``.parquet`` file.

        The file has a row for each frequency and heading, and these columns:

        * ``omega_rad_s``, or ``period_s``;
        * ``heading_deg``, unless all rows are of one heading that is not named, see `heading`;
        * for each coordinate that answers, magnitude and phase: ``heave_m_m`` and
          ``heave_phase_deg``, ``roll_deg_m`` or ``roll_rad_m`` and ``roll_phase_deg``, and so on.

        Args:
            path: The file.
            heading: The heading [°], one of those in the file; None for a file without headings.

        Raises:
            DataError: If the file cannot be read, or columns are missing.
            OutOfRange: If there is no such heading, or as of `Raos`.
        """
        from cranedyn.data.tables import column_names
        from cranedyn.data.trajectory import read_columns

        names = list(column_names(path))
        responses = _response_columns(names, path)
        abscissa = _one_of(names, ("omega_rad_s", "period_s"), path)
        wanted = [abscissa]
        for magnitude, phase, _ in responses.values():
            wanted += [magnitude, phase]
        has_heading = "heading_deg" in names
        values = read_columns(path, [*wanted, *(["heading_deg"] if has_heading else [])])
        rows = np.ones(len(values[abscissa]), dtype=bool)
        if has_heading:
            rows = _rows_of_heading(values["heading_deg"], heading, path)
        elif heading is not None:
            raise DataError(f"{path} has no column heading_deg, from which to take {heading:g}°.")
        frequency = values[abscissa][rows]
        if abscissa == "period_s":
            if not (frequency > 0.0).all():
                raise OutOfRange("period_s of the RAOs", float(frequency.min()), "> 0", "s")
            frequency = 2.0 * math.pi / frequency
        order = np.argsort(frequency)
        response = np.zeros((int(rows.sum()), len(COORDINATES)), dtype=complex)
        for name, (magnitude, phase, scale) in responses.items():
            turned = np.exp(1j * np.radians(values[phase][rows]))
            response[:, COORDINATES.index(name)] = scale * values[magnitude][rows] * turned
        return cls(frequency[order], response[order], heading)

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """Return the responses at angular frequencies [rad/s], complex, shape (k, 6): on straight
        lines between those of the table, real and imaginary part each, and zero beyond its ends.
        """
        columns = []
        for column in self.response.T:
            real = np.interp(frequency, self.frequency, column.real, left=0.0, right=0.0)
            imaginary = np.interp(frequency, self.frequency, column.imag, left=0.0, right=0.0)
            columns.append(real + 1j * imaginary)
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class WaveTrain:
    """Waves of a realisation.

    Attributes:
        amplitude: Amplitudes [m], shape (k,).
        frequency: Angular frequencies [rad/s], shape (k,).
        phase: Phases of the crests at the origin [rad], shape (k,).
    """

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def elevation(self, t: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the elevation of the water at the origin at times [s], shape (times,) [m]."""
        angle = np.multiply.outer(np.asarray(t, dtype=float), self.frequency) + self.phase
        return np.cos(angle) @ self.amplitude


def wave_train(spectrum: Jonswap, *, seed: int, components: int = 200) -> WaveTrain:
    """Return waves with the energy of a spectrum and random phases.

    The range of frequencies is divided into bands of one width, and each wave has the energy of its
    band. Its frequency is random within the band, since equally spaced frequencies would repeat the
    sea after 2π/Δω.

    Args:
        spectrum: The spectrum.
        seed: Seed of the random numbers; the same seed gives the same sea.
        components: Number of waves.

    Raises:
        OutOfRange: If a number is not a whole one, or out of its range.
    """
    generator = np.random.default_rng(whole("seed of the waves", seed, 0))
    count = whole("number of waves", components, 1)
    edges = _frequencies(spectrum, count)
    fine_per_band = max(1, _FINE_STEPS // count)
    fine_edges = _frequencies(spectrum, count * fine_per_band)
    middles = 0.5 * (fine_edges[:-1] + fine_edges[1:])
    energies = (spectrum(middles) * np.diff(fine_edges)).reshape(count, fine_per_band).sum(axis=1)
    share = generator.uniform(size=count)
    phase = generator.uniform(0.0, 2.0 * math.pi, size=count)
    return WaveTrain(np.sqrt(2.0 * energies), edges[:-1] + share * np.diff(edges), phase)


def motion_in_waves(
    spectrum: Jonswap,
    raos: Raos | str | Path,
    *,
    seed: int,
    heading: float | None = None,
    components: int = 200,
) -> BaseMotion:
    """Return the motion of a ship without speed in long-crested waves, one realisation of a sea.

    Args:
        spectrum: Spectrum of the waves.
        raos: Response amplitude operators of the ship, or a file with them, see `Raos.from_file`.
        seed: Seed of the random phases; the same seed gives the same motion.
        heading: Direction in which the waves travel, from the ship's X towards its Y [°]: 180 for
            head seas. One of those in the file; None for a file with none or one.
        components: Number of waves.

    Raises:
        DataError: If the file cannot be read, or columns are missing.
        OutOfRange: If a number is out of its range, or the operators do not cover the waves.
    """
    if not isinstance(raos, Raos):
        raos = Raos.from_file(raos, heading)
    elif heading is not None and heading != raos.heading:
        allowed = f"that of the RAOs, {raos.heading}, or none"
        raise OutOfRange("heading of the waves", heading, allowed, "°")
    waves = wave_train(spectrum, seed=seed, components=components)
    energy = waves.amplitude**2
    covered = (waves.frequency >= raos.frequency[0]) & (waves.frequency <= raos.frequency[-1])
    missed = float(energy[~covered].sum() / max(float(energy.sum()), np.finfo(float).tiny))
    if missed > _LARGEST_MISSED_ENERGY:
        given = f"{raos.frequency[0]:.3g} to {raos.frequency[-1]:.3g}"
        allowed = (
            f"wider: {100.0 * missed:.3g} % of the energy of the waves lies outside, and "
            f"{100.0 * _LARGEST_MISSED_ENERGY:g} % may"
        )
        raise OutOfRange("range of frequencies of the RAOs", given, allowed, "rad/s")
    response = raos.at(waves.frequency) * waves.amplitude[:, None]
    # cos x = sin(x + π/2)
    phase = waves.phase[:, None] + np.angle(response) + 0.5 * math.pi
    frequency = np.tile(waves.frequency[:, None], (1, len(COORDINATES)))
    towards = "" if raos.heading is None else f", heading {raos.heading:g}°"
    source = (
        f"waves of Hs {spectrum.hs:g} m, Tp {spectrum.tp:g} s, γ {spectrum.gamma:g}{towards}, "
        f"seed {seed}"
    )
    return BaseMotion(Harmonics(np.abs(response), frequency, phase), source=source)


@dataclass(frozen=True, eq=False)
class RandomSea:
    """What draws motions of a ship in waves at random, such as one for each episode of a learning
    environment: the sea, the heading and the phases of the waves.

    Attributes:
        spectra: Spectra of the waves; each is as likely as the others.
        raos: Response amplitude operators of the ship, one for each heading; each is as likely.
        components: Number of waves. A learning environment sums their sines in each control period,
            so that fewer of them cost less.
    """

    spectra: Sequence[Jonswap]
    raos: Sequence[Raos]
    components: int = 60

    def __post_init__(self) -> None:
        """Check that there is something to draw from.

        Raises:
            OutOfRange: If there is none, or the operators of a heading do not cover the waves.
        """
        for name, values in (("spectra", self.spectra), ("RAOs", self.raos)):
            if not len(values):
                raise OutOfRange(f"number of {name}", 0, "1 or more")
        whole("number of waves", self.components, 1)
        for spectrum in self.spectra:
            for raos in self.raos:
                motion_in_waves(spectrum, raos, seed=0, components=self.components)

    @classmethod
    def from_file(
        cls,
        spectra: Jonswap | Sequence[Jonswap],
        path: str | Path,
        headings: Sequence[float],
        components: int = 60,
    ) -> RandomSea:
        """Return seas whose operators are those of a file, see `Raos.from_file`.

        Args:
            spectra: Spectrum of the waves, or several.
            path: The file.
            headings: Headings of the waves [°], of those in the file.
            components: Number of waves.

        Raises:
            DataError, OutOfRange: As `Raos.from_file`, and as of `RandomSea`.
        """
        several = [spectra] if isinstance(spectra, Jonswap) else list(spectra)
        raos = [Raos.from_file(path, heading) for heading in headings]
        return cls(several, raos, components)

    def __call__(self, rng: np.random.Generator) -> BaseMotion:
        """Draw a motion."""
        spectrum = self.spectra[int(rng.integers(len(self.spectra)))]
        raos = self.raos[int(rng.integers(len(self.raos)))]
        seed = int(rng.integers(_SEEDS))
        return motion_in_waves(spectrum, raos, seed=seed, components=self.components)


def significant_motion(spectrum: Jonswap, raos: Raos) -> np.ndarray:
    """Return the significant double amplitude of each coordinate, 4 √∫|H|² S dω [m or rad], shape
    (6,): that of the sea state, and not of one realisation.
    """
    edges = _frequencies(spectrum, _FINE_STEPS)
    middles = 0.5 * (edges[:-1] + edges[1:])
    energy = spectrum(middles) * np.diff(edges)
    return 4.0 * np.sqrt(energy @ np.abs(raos.at(middles)) ** 2)


def _frequencies(spectrum: Jonswap, bands: int) -> np.ndarray:
    """Return the edges of bands of one width over the range of a spectrum [rad/s], shape (bands +
    1,).
    """
    ratios = np.linspace(_LOWEST_FREQUENCY, _HIGHEST_FREQUENCY, bands + 1)
    return spectrum.peak_frequency * ratios


def _response_columns(names: Sequence[str], path: str | Path) -> dict[str, tuple[str, str, float]]:
    """Return for each coordinate that answers its columns of magnitude and phase, and the factor to
    m/m or rad/m.

    Raises:
        DataError: If a magnitude has no phase, two columns are of one coordinate, or there is none.
    """
    found: dict[str, tuple[str, str, float]] = {}
    for name, unit in zip(COORDINATES, UNITS, strict=True):
        scales = {f"{name}_{unit}_m": 1.0}
        if unit == "rad":
            scales[f"{name}_deg_m"] = math.pi / 180.0
        column = only_column(name, list(scales), names, path)
        if column is None:
            continue
        phase = f"{name}_phase_deg"
        if phase not in names:
            raise DataError(
                f"{path} has {column} but no {phase}, the phase by which {name} leads the "
                "wave; give it."
            )
        found[name] = (column, phase, scales[column])
    if not found:
        raise DataError(
            f"{path} has no response of a ship; it needs columns such as heave_m_m with "
            "heave_phase_deg, or roll_deg_m with roll_phase_deg."
        )
    return found


def _one_of(names: Sequence[str], choices: Sequence[str], path: str | Path) -> str:
    """Return the one of some columns that a file has.

    Raises:
        DataError: If it has none of them, or several.
    """
    present = [name for name in choices if name in names]
    if len(present) != 1:
        raise DataError(f"{path} needs one of the columns {' and '.join(choices)}.")
    return present[0]


def _rows_of_heading(headings: np.ndarray, heading: float | None, path: str | Path) -> np.ndarray:
    """Return which rows of a file are of a heading [°].

    Raises:
        OutOfRange: If there is none.
    """
    known = np.unique(headings).tolist()
    if heading is None and len(known) == 1:
        return np.ones(len(headings), dtype=bool)
    allowed = "one of " + ", ".join(f"{value:g}" for value in known) + f", those of {path}"
    if heading is None:
        raise OutOfRange("heading of the waves", "none", allowed, "°")
    rows = np.abs(headings - number("heading of the waves", heading, "°")) < _HEADING_TOLERANCE
    if not rows.any():
        raise OutOfRange("heading of the waves", heading, allowed, "°")
    return rows
