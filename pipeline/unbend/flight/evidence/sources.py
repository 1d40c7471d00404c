"""Sources of position and height: steps that no vehicle makes, differences, replacements."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.quality import subset
from unbend.flight.evidence.stretches import ATTITUDE, HEIGHT, POSITION, SECOND, Stretch, runs
from unbend.flight.trajectory import interpolate
from unbend.geodesy import wrapped
from unbend.units import Array, Mask, Rows

# A step from sample to sample that is noise, beyond what velocity and neighbours explain [m].
NOISE_STEP_M = {POSITION: 3.0, HEIGHT: 5.0}
# A difference of two sources that is noise, beyond lag and offset [m].
NOISE_MISFIT_M = {POSITION: 2.0, HEIGHT: 4.0}
WORST_ACCURACY_M = 5.0  # a receiver that reports worse is not used [m]

_SEVERAL = 6.0  # a difference of so many times the usual one is no noise
_RADIUS_M = 6_371_000.0  # for differences of metres: any radius will do
_LONGEST_STEP_S = 10.0
_LONGEST_LAG_S = 0.3  # of receivers; a constant offset seems to be one along a line
_PART_OF_FLIGHT = 0.1  # in which two sources agree: no chance, whatever the rest is like
_MOST_STEPS = 1_000
_SLOPE_M = -8434.5  # dh / d ln p at 288.15 K


@dataclass(frozen=True, eq=False)
class SourcePath:
    """One source of positions or heights, and what it says against itself.

    ``stepped_m`` (n, 2) north and east, or (n, 1) up, is how far its own steps have carried it from
    where it was before and is later.
    """

    channel: Channel
    stepped_m: Array
    good: Mask  # (n,) where it has not stepped away and reports a useful accuracy
    part: Rows  # (n,) number of what lies between restarts and steps that do not return
    step_ns: TimeArray  # of all steps
    lasting_ns: TimeArray  # of those that do not return
    fastest_m_s: float  # the worst step


def is_receiver(channel: Channel) -> bool:
    """Whether a channel is a GNSS receiver, which gives both positions and heights."""
    return {POSITION, HEIGHT} <= set(channel.roles)


def places_of(channel: Channel, quantity: str) -> tuple[Array, Array]:
    """(n, k) places of a channel, and (n - 1, k) metres from each to the next.

    Latitude and longitude [rad], unwrapped, or a height [m] above any one surface.
    """
    if quantity == HEIGHT:
        h = channel[channel.height_column or "h_msl_m"][:, None]
        return h, np.diff(h, axis=0)
    places = np.stack([channel["lat_rad"], np.unwrap(channel["lon_rad"])], axis=1)
    return places, metres(np.diff(places, axis=0), places[1:, 0])


def with_places(channel: Channel, quantity: str) -> Channel:
    """The samples of a channel whose place is known; none where it gives none."""
    if quantity == HEIGHT and channel.height_column is None:
        return subset(channel, np.zeros(len(channel), np.bool_))
    known = np.asarray(np.isfinite(places_of(channel, quantity)[0]).all(axis=1))
    return channel if known.all() else subset(channel, known)


def metres(change: Array, lat_rad: Array) -> Array:
    """(n, 2) metres north and east of (n, 2) changes of latitude and longitude [rad]."""
    east = wrapped(change[:, 1]) * np.cos(lat_rad)
    return _RADIUS_M * np.stack([change[:, 0], east], axis=1)


def velocity_at(channels: Iterable[Channel], quantity: str, time_ns: TimeArray) -> Array:
    """(n, 2) north and east or (n, 1) up [m/s] from the first channel that has it; NaN without."""
    names = ("v_down_m_s",) if quantity == HEIGHT else ("v_north_m_s", "v_east_m_s")
    for channel in channels:
        if len(channel) > 1 and all(name in channel.columns for name in names):
            gap_s = channel.gap_limit_s(2.0)
            found = [interpolate(channel, name, time_ns, gap_s) for name in names]
            return np.stack(found, axis=1) * (-1.0 if quantity == HEIGHT else 1.0)
    return np.full((time_ns.size, len(names)), np.nan)


def source_path(channel: Channel, quantity: str, channels: Iterable[Channel]) -> SourcePath:
    """A source with the steps that no vehicle makes, whatever happens between them.

    A step is what neither the velocity (of the first of ``channels`` that has one) nor the speed of
    neighbouring samples explains: more than 3 m, 5 m in height, and several times what is usual.
    From the one that leaves to the one that returns the source is away; one without return parts
    the channel.
    """
    channel = with_places(channel, quantity)
    time_ns, n = channel.time_ns, len(channel)
    _, moved = places_of(channel, quantity)
    dt = np.diff(time_ns)[:, None] * 1e-9
    around = sliding_window_view(np.pad(moved / dt, ((3, 3), (0, 0)), mode="edge"), 7, axis=0)
    rest = moved / dt - np.partition(around, 3, axis=-1)[..., 3]  # about the median of seven
    velocity = velocity_at(channels, quantity, time_ns)
    by_velocity = moved / dt - 0.5 * (velocity[1:] + velocity[:-1])
    smaller = np.linalg.norm(by_velocity, axis=1) < np.linalg.norm(rest, axis=1)
    rest = dt * np.where(smaller[:, None], by_velocity, rest)
    torn = (np.diff(channel.boot) != 0) | (dt[:, 0] > _LONGEST_STEP_S)
    rest[torn] = 0.0
    size = np.linalg.norm(rest, axis=1)
    noise = max(NOISE_STEP_M[quantity], _SEVERAL * float(np.percentile(size, 95.0)))
    step = np.flatnonzero(size > noise + 2.0 * dt[:, 0] ** 2)
    step = step if step.size <= _MOST_STEPS else step[:0]  # a channel that always steps is noise
    near = np.zeros(n - 1, np.bool_)  # a receiver smooths a step: what is left of it lies beside
    for row in step:
        near |= np.abs(time_ns[1:] - time_ns[row + 1]) <= SECOND
    place = np.cumsum(np.where(near[:, None], rest, 0.0), axis=0)
    place = np.concatenate([np.zeros((1, moved.shape[1])), place])
    edges = [0, *(step + 1).tolist(), n]
    levels = [np.median(place[a:b], axis=0) for a, b in pairwise(edges)]
    stepped, part, lone = np.zeros_like(place), channel.boot.astype(np.intp), list[int]()
    base, k = levels[0], 1
    while k < len(levels):
        leap = float(np.linalg.norm(levels[k] - base))
        back = k
        if leap > noise:
            tolerance = noise + 0.1 * leap
            later = range(k + 1, len(levels))
            back = next((j for j in later if np.linalg.norm(levels[j] - base) < tolerance), 0)
            if back:
                stepped[edges[k] : edges[back]] = place[edges[k] : edges[back]] - base
            else:
                base, lone = levels[k], [*lone, edges[k]]
                part[edges[k] :] += int(part.max()) + 1
        k = max(back, k + 1)
    good = np.asarray(~stepped.any(axis=1))
    sigma = channel.columns.get("sigma_v_m" if quantity == HEIGHT else "sigma_h_m")
    if sigma is not None and np.isfinite(sigma).any():
        good &= ~(sigma > max(WORST_ACCURACY_M, 3.0 * float(np.nanmedian(sigma))))
    fastest = float((size[step] / dt[step, 0]).max()) if step.size else 0.0
    return SourcePath(channel, stepped, good, part, time_ns[step + 1], time_ns[lone], fastest)


@dataclass(frozen=True, eq=False)
class Difference:
    """How far a source is from another, at the times of the other.

    NaN where either is missing, or the other's accuracy is poor.
    """

    other: SourcePath
    apart_m: Array  # (n, k) from the other less its own steps and its constant lag ``lag_s``
    off_m: Array  # (n,) beyond the usual offset
    lag_s: float
    limit_m: float  # the largest ``off_m`` that is noise
    scatter_m: float  # its standard deviation

    @property
    def apart(self) -> list[tuple[int, int]]:
        """Rows of the other between which the two differ by more than noise."""
        with np.errstate(invalid="ignore"):
            bad, seed = self.off_m > 0.5 * self.limit_m, self.off_m > self.limit_m
        return runs(self.other.channel.time_ns, bad, seed)


def difference(
    mine: Channel,
    other: SourcePath,
    quantity: str,
    velocity: Array,
    *,
    steady_until_ns: int | None = None,
) -> Difference:
    """How far ``mine`` is from another source; ``velocity`` (n, k) [m/s] at the times of that.

    The usual offset is the median, or that of a tenth of the flight or more in which the two agree:
    positions, and heights of receivers, near 0; other heights before ``steady_until_ns``, when
    ``mine`` stepped and did not return.
    """
    time_ns = other.channel.time_ns
    theirs, _ = places_of(other.channel, quantity)
    own, _ = places_of(mine, quantity)
    gap_s = mine.gap_limit_s(2.0)
    placed = replace(mine, columns=dict(zip("xy", own.T, strict=False)), labels={})
    own = np.stack([interpolate(placed, n, time_ns, gap_s) for n in placed.columns], axis=1)
    apart = own - theirs if quantity == HEIGHT else metres(own - theirs, theirs[:, 0])
    apart += other.stepped_m
    known = np.isfinite(apart).all(axis=1) & other.good
    velocity, noise_m = np.nan_to_num(velocity), NOISE_MISFIT_M[quantity]
    speed2 = np.sum(velocity**2, axis=1)
    fast = known & (speed2 > max(4.0, 0.1 * float(np.percentile(speed2, 95.0))))
    near_zero = quantity == POSITION or (is_receiver(mine) and is_receiver(other.channel))
    lag_s = 0.0
    if np.count_nonzero(fast) >= 20:
        known = fast
        lags = np.sum(apart * velocity, axis=1)[fast] / speed2[fast]
        lag_s = float(np.median(lags))
        if near_zero and np.median(np.abs(lags - lag_s)) * np.sqrt(np.median(speed2)) > noise_m:

            def closest(lag_s: float) -> float:
                left = np.linalg.norm(apart[fast] - lag_s * velocity[fast], axis=1)
                return float(np.percentile(left, 100.0 * _PART_OF_FLIGHT))

            parts = [float(np.median(part)) for part in np.array_split(lags, 20)]
            lag_s = min([lag_s, *(lag for lag in parts if abs(lag) < _LONGEST_LAG_S)], key=closest)
    apart -= lag_s * velocity
    reported = other.good | other.stepped_m.any(axis=1)
    apart[~reported] = np.nan
    off, settled = np.full(time_ns.size, np.nan), np.zeros(time_ns.size, np.bool_)
    early = time_ns < (time_ns[0] if steady_until_ns is None else steady_until_ns)
    agree = np.linalg.norm(apart, axis=1) < noise_m if near_zero else early
    for part in np.unique(other.part):  # heights above home have a new home in each
        rows = other.part == part
        usable = rows & known if (rows & known).any() else rows & np.isfinite(apart).all(axis=1)
        if not usable.any():
            continue
        offset_m, least = np.median(apart[usable], axis=0), _PART_OF_FLIGHT * usable.sum()
        if np.count_nonzero(usable & agree) > least:
            usual_m = np.median(apart[usable & agree], axis=0)
            if np.linalg.norm(usual_m - offset_m) > noise_m:
                usable, offset_m = usable & agree, usual_m
        off[rows] = np.linalg.norm(apart[rows] - offset_m, axis=1)
        settled |= usable & known
    scatter_m = 1.48 * float(np.median(off[settled])) if settled.any() else 0.0
    return Difference(other, apart, off, lag_s, max(noise_m, _SEVERAL * scatter_m), scatter_m)


def moved(channel: Channel, rows: Mask, by_m: Array, height_column: str | None) -> dict[str, Array]:
    """Columns of some rows of a channel, moved by (2,) metres north and east or (1,) up."""
    if by_m.size == 1:
        h = channel[channel.height_column or "h_msl_m"][rows] + by_m[0]
        others = ("h_msl_m", "h_ellipsoid_m", "h_home_m", "h_gnss_m")
        return dict.fromkeys(others, np.full(h.shape, np.nan)) | {height_column or "h_msl_m": h}
    lat, lon = channel["lat_rad"][rows], channel["lon_rad"][rows]
    north, east = by_m / _RADIUS_M
    return {"lat_rad": lat + north, "lon_rad": lon + east / np.cos(lat)}


def height_of_pressure(barometer: Channel, height: Channel) -> Channel | None:
    """A barometer as a source of heights, by the flight's own relation of height and ln p.

    A parabola, fitted twice without outliers, or a line of standard air where the flight spans
    under 300 m. None for one that gives no heights.
    """
    column = height.height_column
    if column is None or "pressure_pa" not in barometer.columns:
        return None
    h = interpolate(height, column, barometer.time_ns, height.gap_limit_s(2.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        log_p = np.log(barometer["pressure_pa"])
    use = np.isfinite(h) & np.isfinite(log_p)
    if np.count_nonzero(use) < 30:
        return None
    heights = np.full(h.shape, np.nan)
    for _ in range(2):
        if float(np.ptp(h[use])) > 300.0:
            heights = np.polynomial.Polynomial.fit(log_p[use], h[use], 2)(log_p)
        else:
            heights = float(np.median(h[use] - _SLOPE_M * log_p[use])) + _SLOPE_M * log_p
        off = np.abs(h - heights)
        use &= off < max(3.0 * 1.48 * float(np.nanmedian(off)), 1.0)
    return replace(barometer, columns={"h_msl_m": heights}, roles=(), labels={})


LONGEST_COAST_S = 2.0  # a filter without a receiver for longer is no longer known to be right [s]
BESIDE_S = 10.0  # a source that replaces another agrees with it for so long before and after [s]
# A filter without its receiver, or a barometer, replaces a receiver for no longer [s].
LONGEST_REPLACED_S = 60
# Half the acceleration by which a filter drifts whose vertical is 0.25 degrees wrong [m/s2].
LARGEST_DRIFT_M_S2 = 0.02


@dataclass(frozen=True, eq=False)
class Sources:
    """The source that plays the role of a quantity, and its difference from each other one."""

    quantity: str
    own: SourcePath
    differences: tuple[Difference, ...]
    barometers: tuple[str, ...] = ()  # those compared, first the one of the role of the pressure


def replacement_for(sources: Sources, stretch: Stretch) -> tuple[Difference, list[Array]] | None:
    """The source that replaces a suspect one where it is plain who is wrong, and two offsets.

    Who is wrong has steps of its own, a poor accuracy or no fix: the source itself, or, where that
    is a filter, one of several receivers. The replacement has none of these, and agrees for 10 s
    before and after. A filter or a barometer replaces a receiver for at most 60 s.
    """
    own, long = sources.own, stretch.end_ns - stretch.begin_ns > LONGEST_REPLACED_S * SECOND
    wide = replace(stretch, begin_ns=stretch.begin_ns - SECOND, end_ns=stretch.end_ns + SECOND)
    margin = int(BESIDE_S * SECOND)
    before = replace(wide, begin_ns=wide.begin_ns - margin, end_ns=wide.begin_ns)
    after = replace(wide, begin_ns=wide.end_ns, end_ns=wide.end_ns + margin)

    def fails(track: SourcePath) -> bool:
        rows = wide.covers(track.channel.time_ns)
        silent = bool(np.diff(track.channel.time_ns[rows], prepend=wide.begin_ns,
                              append=wide.end_ns).max() > LONGEST_COAST_S * SECOND)  # fmt: skip
        return silent or not track.good[rows].all() or bool(wide.covers(track.step_ns).any())

    paths = [own, *(d.other for d in sources.differences)]
    if not any(fails(path) for path in paths if is_receiver(path.channel)):
        return None
    for d in sources.differences:
        channel = d.other.channel
        if fails(d.other) or (not is_receiver(channel) and (long or not is_receiver(own.channel))):
            continue
        known = np.isfinite(d.off_m)
        sides = [side.covers(channel.time_ns) & known for side in (before, after)]
        if all(s.sum() > 4 and np.percentile(d.off_m[s], 90.0) < d.limit_m for s in sides):
            return d, [np.median(d.apart_m[side], axis=0) for side in sides]
    return None


def drifted(own: SourcePath, d: Difference, stretch: Stretch) -> list[Stretch]:
    """A filter that left its replacement without a step has a wrong vertical: a suspect attitude.

    A quarter of a degree of tilt carries a coasting filter 0.02 m/s² t² away.
    """
    time_ns = d.other.channel.time_ns
    stepped = np.interp(time_ns, own.channel.time_ns, own.stepped_m.any(axis=1))
    off = np.where(stretch.covers(time_ns) & (stepped == 0.0), np.nan_to_num(d.off_m), 0.0)
    worst = int(np.argmax(off))
    t = (int(time_ns[worst]) - stretch.begin_ns) / SECOND
    if off[worst] < max(d.limit_m, LARGEST_DRIFT_M_S2 * t**2):
        return []
    reason = f"{own.channel.name} drifts {off[worst]:.0f} m in {t:.0f} s, as with a wrong vertical"
    return [replace(stretch, quantity=ATTITUDE, reason=reason, off_m=np.nan)]


def with_replaced(channel: Channel, d: Difference, stretch: Stretch, by_m: list[Array]) -> Channel:
    """The channel with the samples of another source in a stretch, its lag and offset taken out.

    ``by_m`` are the offsets before and after, of which the mean counts; half their difference and
    the usual difference of the two go into the standard deviation, with the source's own.
    """
    other, sigma = d.other.channel, "sigma_v_m" if stretch.quantity == HEIGHT else "sigma_h_m"
    time_ns = other.time_ns - round(d.lag_s * 1e9)
    inside, keep = stretch.covers(time_ns), ~stretch.covers(channel.time_ns)
    spread = np.hypot(0.5 * float(np.linalg.norm(by_m[1] - by_m[0])), d.scatter_m)
    fill = {name: values[inside] for name, values in other.columns.items()}
    fill |= moved(other, inside, 0.5 * (by_m[0] + by_m[1]), channel.height_column)
    unknown = np.full(np.count_nonzero(inside), np.nan)
    fill[sigma] = np.hypot(np.nan_to_num(fill.get(sigma, unknown)), spread)
    both = np.concatenate([channel.time_ns[keep], time_ns[inside]])
    joined, rows = np.unique(both, return_index=True)
    boot = np.concatenate([channel.boot[keep], other.boot[inside]])[rows]
    columns = {
        name: np.concatenate([channel.get(name)[keep], fill.get(name, unknown)])[rows]
        for name in (*channel.columns, sigma)
    }
    return replace(channel, time_ns=joined, boot=boot, columns=columns, labels={})
