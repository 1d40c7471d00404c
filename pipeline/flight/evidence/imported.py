"""Where a trajectory or positions of camera events of another program are suspect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.flight.evidence.contradictions import own_contradictions
from pipeline.flight.evidence.sources import difference, source_path, velocity_at, with_places
from pipeline.flight.evidence.stretches import (
    HEIGHT,
    POSITION,
    Stretch,
    beside,
    covered,
    merged,
    runs,
)

# A difference from the log that is an autopilot's own, beyond a constant one [m].
LEAST_M = {POSITION: 5.0, HEIGHT: 10.0}

_FEWEST, _SLOWEST_HZ, _SIGMAS = 10, 1.0, 3.0


def contradictions_of_import(
    imported: Channel,
    quantities: Sequence[str],
    own: Mapping[str, Channel],
    own_suspect: Sequence[Stretch],
) -> tuple[Stretch, ...]:
    """Stretches in which an imported channel steps, or leaves what the log has in the same roles.

    ``own`` are the roles as the log fills them, ``own_suspect`` the stretches in which these are
    suspect: there they say nothing against others. Steps are looked for at 1 Hz and faster. What
    the channel's own standard deviations (three of them) explain is no contradiction.
    """
    found = []
    for quantity in (q for q in (POSITION, HEIGHT) if q in quantities):
        mine = with_places(imported, quantity)
        if len(mine) <= _FEWEST:
            continue
        sigma = mine.columns.get("sigma_v_m" if quantity == HEIGHT else "sigma_h_m")
        stated = np.zeros(len(mine)) if sigma is None else np.nan_to_num(sigma)
        bare = {name: v for name, v in mine.columns.items() if not name.startswith("sigma_")}
        moving = [mine, *(own[name] for name in (POSITION, HEIGHT) if name in own)]
        path = source_path(replace(mine, columns=bare), quantity, moving)
        stretches = own_contradictions(path, quantity) if mine.rate_hz >= _SLOWEST_HZ else []
        log = with_places(own[quantity], quantity) if quantity in own else None
        if log is not None and len(log) > _FEWEST:
            still, one = np.zeros_like(path.stepped_m), mine.boot.astype(np.intp)
            whole = replace(path, stepped_m=still, good=np.ones(len(mine), np.bool_), part=one)
            # Heights above two surfaces are apart where nothing lags.
            velocity = still if quantity == HEIGHT else velocity_at(moving, quantity, mine.time_ns)
            apart = difference(log, whole, quantity, velocity)
            silent = covered([s for s in own_suspect if s.quantity == quantity], mine.time_ns)
            off = np.where(silent, 0.0, np.nan_to_num(apart.off_m))
            limit = max(apart.limit_m, LEAST_M[quantity])
            for a, b in runs(mine.time_ns, off > 0.5 * limit, off > limit):
                off_m = float(off[a : b + 1].max())
                reason = f"{mine.name} and {log.name} are {off_m:.0f} m apart"
                stretches.append(Stretch(*beside(mine.time_ns, a, b), quantity, reason, off_m))
        for stretch in merged(stretches):
            reported = float(stated[stretch.covers(mine.time_ns)].max(initial=0.0))
            if not stretch.off_m < _SIGMAS * reported:
                found.append(stretch)
    return tuple(found)
