"""A flight of known position and attitude, and files of it as other programs write them.

The truth does not use the package: coordinates by pyproj, GPS time by the calendar.
"""

from datetime import UTC, datetime, timedelta

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from tests.tables.exports.export_runs import TO_ECEF, enu_axes
from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.imports.stated import Stated

WEEK = 2417
TOW = 302_400.0
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
START = GPS_EPOCH + timedelta(weeks=WEEK, seconds=TOW - 18.0)
LAT = 47.3
LON = 8.5
HEIGHT = 1500.0
SPEED_M_S = 40.0
TURN_RAD_S = 2.0 * np.pi / 307.0


class Flight:
    """A circle to the right: (n,) seconds since `START`, and the truth there.

    Degrees of places, metres, radians of attitudes, velocity to the north, east and down.
    """

    def __init__(self, folder, t):
        self.folder = folder
        self.t = t
        course = TURN_RAD_S * t
        radius_m = SPEED_M_S / TURN_RAD_S
        enu = [
            radius_m * (1.0 - np.cos(course)),
            radius_m * np.sin(course),
            5.0 * np.sin(t / 20.0),
        ]
        start = TO_ECEF.transform(LON, LAT, HEIGHT)
        ecef = np.transpose([start]) + enu_axes(LON, LAT).T @ enu
        self.places = TO_ECEF.transform(*ecef, direction="INVERSE")
        self.lon, self.lat, self.height = self.places
        # The block is small: within 0.03 degrees of the axes at its start.
        north = SPEED_M_S * np.cos(course)
        east = SPEED_M_S * np.sin(course)
        down = -0.25 * np.cos(t / 20.0)
        self.velocity = np.stack([north, east, down], axis=1)
        self.yaw = course + np.radians(4.0)  # it crabs
        self.pitch = np.radians(2.0 + np.sin(t / 7.0))
        self.roll = np.radians(3.0) * np.sin(t / 5.0)

    def at_times(self, t):
        """The same flight at other times."""
        return Flight(self.folder, t)

    @property
    def utc_ns(self):
        start_ns = round(START.timestamp()) * 10**9
        since_ns = np.rint(self.t * 1e9)
        return start_ns + since_ns.astype(np.int64)

    @property
    def attitude(self):
        """v_ned = R v_body."""
        angles = np.stack([self.yaw, self.pitch, self.roll], axis=1)
        return Rotation.from_euler("ZYX", angles)

    def gpst(self, k):
        time = START + timedelta(seconds=18.0 + float(self.t[k]))
        return f"{time:%Y/%m/%d %H:%M:%S.%f}"[:-3]

    def put(self, name, content):
        path = self.folder / name
        if isinstance(content, str):
            content = content.encode()
        path.write_bytes(content)
        return path

    def pos(self, name="flight.pos", *, quality=1):
        """As RTKLIB writes it: sigmas north 0.011, east 0.007, up 0.021."""
        lines = [
            "% program   : RTKPOST ver.2.4.3 b34\n"
            "% obs start : 2026/05/06 12:00:00.0 GPST (week2417 302400.0s)\n%\n"
            "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
            "ns=# of satellites)\n"
            "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)"
            "   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
        ]
        quality = np.broadcast_to(quality, self.t.size)
        for k, q in enumerate(quality):
            lines.append(
                f"{self.gpst(k)} {self.lat[k]:14.9f} {self.lon[k]:14.9f} {self.height[k]:10.4f} "
                f"{q:3d}  12   0.0110   0.0070   0.0210   0.0010  -0.0020   0.0030   0.00    9.9\n"
            )
        return self.put(name, "".join(lines))

    def sbet_rows(self, *, wander_deg=1.3, sign=1.0):
        """POSPac: x north, y west, z up in the wander frame; platform heading = true + wander."""
        wander = np.radians(wander_deg) + 1e-4 * self.t
        north, east, down = self.velocity.T
        turn = np.exp(-1j * sign * wander)
        ground = (north - 1j * east) * turn
        heading = self.yaw + sign * wander
        later = self.at_times(self.t + 0.001).attitude
        turned = self.attitude.inv() * later
        return np.column_stack(
            [
                TOW + self.t,
                np.radians(self.lat),
                np.radians(self.lon),
                self.height,
                ground.real,
                ground.imag,
                -down,
                self.roll,
                self.pitch,
                (heading + np.pi) % (2 * np.pi) - np.pi,
                wander,
                np.zeros((self.t.size, 3)),
                turned.as_rotvec() / 0.001,
            ]
        )

    def sbet(self, *, rows=None, **how):
        if rows is None:
            rows = self.sbet_rows(**how)
        return self.put("sbet.out", rows.astype("<f8").tobytes())

    def smrmsg(self):
        """Once a second: north 0.03, east 0.04, down 0.05 m; 0.6, 0.8, 3 arcmin."""
        t = np.arange(self.t.min() - 1.0, self.t.max() + 2.0)
        rows = np.empty((t.size, 10))
        rows[:, 0] = TOW + t
        rows[:, 1:4] = [0.03, 0.04, 0.05]
        rows[:, 4:7] = 0.01
        rows[:, 7:] = [0.6, 0.8, 3.0]
        return self.put("smrmsg.out", rows.astype("<f8").tobytes())

    def mrk(self):
        lines = []
        for k in range(self.t.size):
            lines.append(
                f"{k + 1}\t{TOW + self.t[k]:.6f}\t[{WEEK}]\t   -40,N\t    12,E\t   186,V\t"
                f"{self.lat[k]:.8f},Lat\t{self.lon[k]:.8f},Lon\t{self.height[k]:.3f},Ellh\t"
                "0.012000, 0.016000, 0.031000\t50,Q\n"
            )
        return self.put("100_0001_Timestamp.MRK", "".join(lines))

    def eo(
        self,
        angles=(-1.05, 0.32, 179.18),
        head="",
        shift=(0.0, 0.0, 0.0),
    ):
        """POSPac's text with angles (n, 3) in its unit, more lines of its head, and shifted places.

        Easting, northing and height are shifted; latitude and longitude are not.
        """
        in_grid = pyproj.Proj("EPSG:32632")(self.lon, self.lat)
        grid = np.transpose([*in_grid, self.height]) + shift
        lines = [
            f"POS/AV Computed Data at Camera Perspective Centre\n{head}"
            "  Grid: Universal Transverse Mercator; Zone:  UTM North 32 (006E to 012E) ;\n"
            "  Datum: WGS84 ;\n"
            "  (position in Meters, orientation in Degrees, lat, long in Deg)\n\n"
            "ID\t# EVENT\tTIME (s)\tEASTING\tNORTHING\tELLIPSOID HEIGHT\tOMEGA\tPHI\tKAPPA\tLAT\t"
            "LONG\n"
        ]
        angles = np.broadcast_to(angles, (self.t.size, 3))
        for k, (first, second, third) in enumerate(angles):
            east, north, up = grid[k]
            lines.append(
                f"img_{k:03d}\t{k + 1}\t{TOW + self.t[k]:.6f}\t{east:.4f}\t{north:.4f}\t"
                f"{up:.4f}\t{first:.9f}\t{second:.9f}\t{third:.9f}\t"
                f"{self.lat[k]:.9f}\t{self.lon[k]:.9f}\n"
            )
        return self.put("eo.txt", "".join(lines))


def read(reader, path, settings=None):
    """What a reader makes of a file, and what it says of it."""
    ledger = Ledger()
    channel = reader(path, settings or Stated(), ledger)
    return channel, ledger


def refusal_of(reader, path, settings=None):
    """How a reader refuses a file, which says what to do."""
    with pytest.raises(InputError) as caught:
        reader(path, settings or Stated(), Ledger())
    assert caught.value.remedy
    return caught.value


def ns_off(channel, flight, later_ns=0):
    """The largest difference of times from the truth, or from times later than that."""
    return np.abs(channel.time_ns - flight.utc_ns - later_ns).max()


def metres_off(channel, flight):
    """The largest difference in place and height from the truth."""
    cosine = np.cos(np.radians(flight.lat))
    north = (channel["lat_rad"] - np.radians(flight.lat)) * 6.37e6
    east = (channel["lon_rad"] - np.radians(flight.lon)) * 6.38e6 * cosine
    up = channel["h_ellipsoid_m"] - flight.height
    return np.abs([north, east, up]).max()


def degrees_off(channel, flight):
    """The largest angle between the attitudes and the true ones."""
    quaternions = [channel[f"q_{axis}"] for axis in "xyzw"]
    attitude = Rotation.from_quat(np.transpose(quaternions))
    apart = attitude.inv() * flight.attitude
    return np.degrees(apart.magnitude().max())


def assert_place(channel, row, lat_deg, lon_deg, tolerance_deg=1e-10):
    lat_rad = channel["lat_rad"][row]
    lon_rad = channel["lon_rad"][row]
    assert np.degrees(lat_rad) == pytest.approx(lat_deg, abs=tolerance_deg)
    assert np.degrees(lon_rad) == pytest.approx(lon_deg, abs=tolerance_deg)


def utc_text(channel, row):
    return str(np.datetime64(int(channel.time_ns[row]), "ns"))
