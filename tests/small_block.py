"""A small block with known truth, written as other programs write it.

Everything is computed here, by plain formulas: stations above one place, a camera at each that
looks down, object points, and their pixels by a pinhole with Brown's distortion. A test compares
what the program reads with `SmallBlock`, in which each attitude is against the station's own
vertical.
"""

import json
import sqlite3
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tests.lens import brown

A = 6378137.0
E2 = 0.00669437999014
WIDTH = 6000
HEIGHT = 4000
FOCAL = 5000.0
CX = 3011.5
CY = 1992.25
K1 = -0.021
K2 = 0.008
K3 = -0.001
P1 = 0.0004
P2 = -0.0003
OPENCV = (K1, K2, P1, P2, K3)
Y_UP_Z_BACK = np.diag([1.0, -1.0, -1.0])  # of x right, y down, z forward


def ecef(lat_deg, lon_deg, h, *, a=A, e2=E2):
    """(n, 3) earth-centred coordinates, written out here."""
    lat = np.radians(lat_deg)
    lon = np.radians(lon_deg)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    x = (n + h) * np.cos(lat) * np.cos(lon)
    y = (n + h) * np.cos(lat) * np.sin(lon)
    z = (n * (1 - e2) + h) * np.sin(lat)
    return np.stack([x, y, z], axis=-1)


def enu_axes(lat_deg, lon_deg):
    """(3, 3) rows east, north, up at a place, in earth-centred coordinates."""
    lat = np.radians(lat_deg)
    lon = np.radians(lon_deg)
    sin_lat = np.sin(lat)
    cos_lat = np.cos(lat)
    sin_lon = np.sin(lon)
    cos_lon = np.cos(lon)
    east = [-sin_lon, cos_lon, 0.0]
    north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
    up = [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]
    return np.array([east, north, up])


def pixels(cam):
    """(n, 2) pixels of points in the axes of a camera, upper left corner (0, 0)."""
    x, y = brown(cam[:, 0] / cam[:, 2], cam[:, 1] / cam[:, 2], *OPENCV)
    return np.stack([CX + FOCAL * x, CY + FOCAL * y], axis=1)


@dataclass
class SmallBlock:
    """Stations (n,) with attitudes cam_from_enu (n, 3, 3) against their own verticals, points."""

    lat: np.ndarray
    lon: np.ndarray
    h: np.ndarray
    cam_from_enu: np.ndarray
    point_lat: np.ndarray
    point_lon: np.ndarray
    point_h: np.ndarray
    observations: pd.DataFrame
    names: list[str]
    origin: tuple[float, float, float]

    @classmethod
    def make(cls, lat0=46.95, lon0=7.45, *, spacing_m=300.0):
        """Twelve images in three lines 1.5 km above 60 points."""
        draw = np.random.default_rng(5)
        line, place = np.divmod(np.arange(12), 4)
        degree_m = np.radians(1.0) * A
        degree_east_m = degree_m * np.cos(np.radians(lat0))
        h = 2000.0 + draw.normal(0.0, 8.0, 12)
        tilts = draw.normal(0.0, 2.0, (12, 3)) + np.array([0.0, 0.0, 90.0])
        tilts[4:8, 2] += 180.0  # the aircraft comes back
        turns = Rotation.from_euler("xyz", tilts, degrees=True).as_matrix()
        block = cls(
            lat=lat0 + (line - 1.0) * spacing_m / degree_m,
            lon=lon0 + (place - 1.5) * spacing_m / degree_east_m,
            h=h,
            cam_from_enu=Y_UP_Z_BACK @ turns.transpose(0, 2, 1),  # x east, y south, z down
            point_lat=lat0 + draw.uniform(-900, 900, 60) / degree_m,
            point_lon=lon0 + draw.uniform(-900, 900, 60) / degree_east_m,
            point_h=500.0 + draw.uniform(0.0, 60.0, 60),
            observations=pd.DataFrame(),
            names=[f"IMG_{k:04d}.JPG" for k in range(1, 13)],
            origin=(lat0, lon0, 0.0),
        )
        block.observations = block.observed()
        return block

    @property
    def centres(self):
        """(n, 3) earth-centred."""
        return ecef(self.lat, self.lon, self.h)

    def cam_from_ecef(self):
        axes = list(map(enu_axes, self.lat, self.lon))
        return self.cam_from_enu @ np.array(axes)

    def observed(self):
        places = ecef(self.point_lat, self.point_lon, self.point_h)
        turns = self.cam_from_ecef()
        rows = []
        for name, centre, turn in zip(self.names, self.centres, turns, strict=True):
            uv = pixels((places - centre) @ turn.T)
            inside = (uv > 0) & (uv < [WIDTH, HEIGHT])
            for k in np.flatnonzero(inside.all(axis=1)):
                rows.append((name, f"{k + 1}", *uv[k]))
        return pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])

    def seen_in(self, name):
        """The observations of an image."""
        return self.observations[self.observations["image"] == name]

    def in_enu(self):
        """Centres (n, 3), rotations to the camera (n, 3, 3), and points (p, 3), at the origin."""
        axes = enu_axes(*self.origin[:2])
        zero = ecef(*self.origin)
        centres = (self.centres - zero) @ axes.T
        points = ecef(self.point_lat, self.point_lon, self.point_h) - zero
        return centres, self.cam_from_ecef() @ axes.T, points @ axes.T

    def table(self):
        """Latitude, longitude, height and cam_from_enu by image."""
        values = zip(self.lat, self.lon, self.h, self.cam_from_enu, strict=True)
        return dict(zip(self.names, values, strict=True))

    def write_colmap(self, folder, *, scale=1.0, turn=None):
        """A sparse model as text, in ``scale`` * (``turn`` applied to east, north, up)."""
        if turn is None:
            turn = np.eye(3)
        centres, rotations, points = self.in_enu()
        centres = scale * centres @ turn.T
        points = scale * points @ turn.T
        rotations = rotations @ turn.T
        folder.mkdir(parents=True, exist_ok=True)
        coefficients = " ".join(map(str, OPENCV))
        (folder / "cameras.txt").write_text(
            f"1 FULL_OPENCV {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {CX} {CY} {coefficients} 0 0 0\n"
        )
        lines = []
        tracks = {k + 1: "" for k in range(len(points))}
        for number, name in enumerate(self.names):
            x, y, z, w = Rotation.from_matrix(rotations[number]).as_quat()
            step = -rotations[number] @ centres[number]
            lines.append(f"{number + 1} {w} {x} {y} {z} {step[0]} {step[1]} {step[2]} 1 {name}")
            pixels_of_image = []
            for k, r in enumerate(self.seen_in(name).itertuples()):
                pixels_of_image.append(f"{r.x_px} {r.y_px} {r.point}")
                tracks[int(r.point)] += f" {number + 1} {k}"
            lines.append(" ".join(pixels_of_image))
        (folder / "images.txt").write_text("\n".join(lines) + "\n")
        rows = []
        for number, (x, y, z) in enumerate(points, 1):
            if tracks[number]:
                rows.append(f"{number} {x} {y} {z} 0 0 0 -1{tracks[number]}")
        (folder / "points3D.txt").write_text("\n".join(rows) + "\n")

    def write_colmap_database(self, path, *, known, system=0):
        """A database with keypoints and pose priors ``known`` (n, 3), of COLMAP 3.9's tables."""
        with sqlite3.connect(path) as base:
            base.executescript(
                "CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY, model INTEGER, width INTEGER,"
                " height INTEGER, params BLOB, prior_focal_length INTEGER);"
                "CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER);"
                "CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER,"
                " data BLOB);"
                "CREATE TABLE matches (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER,"
                " data BLOB);"
                "CREATE TABLE pose_priors (image_id INTEGER PRIMARY KEY, position BLOB,"
                " coordinate_system INTEGER, position_covariance BLOB);"
            )
            params = np.array([FOCAL, FOCAL, CX, CY, *OPENCV, 0, 0, 0])
            camera = (WIDTH, HEIGHT, params.tobytes())
            base.execute("INSERT INTO cameras VALUES (1, 6, ?, ?, ?, 1)", camera)
            for number, name in enumerate(self.names, 1):
                base.execute("INSERT INTO images VALUES (?, ?, 1)", (number, name))
                rows = self.seen_in(name)
                xy = rows[["x_px", "y_px"]].to_numpy(np.float32)
                keypoints = (number, len(xy), xy.tobytes())
                base.execute("INSERT INTO keypoints VALUES (?, ?, 2, ?)", keypoints)
                if known is not None:
                    prior = (number, known[number - 1].astype(float).tobytes(), system)
                    base.execute("INSERT INTO pose_priors VALUES (?, ?, ?, NULL)", prior)

    def write_opensfm(self, folder, *, name="reconstruction.json", linear=None):
        """A project; ``linear`` (3, 4) is ODM's transformation from east, north, up, if any."""
        centres, rotations, points = self.in_enu()
        known = centres + np.random.default_rng(2).normal(0.0, 0.5, centres.shape)
        if linear is not None:
            centres = centres @ linear[:, :3].T + linear[:, 3]
            points = points @ linear[:, :3].T + linear[:, 3]
            # As OpenSfM does it: R inv(A), of which Rodrigues takes the nearest rotation.
            u, _, vt = np.linalg.svd(rotations @ np.linalg.inv(linear[:, :3]))
            rotations = u @ vt
        size = max(WIDTH, HEIGHT)
        camera = {
            "projection_type": "brown",
            "width": WIDTH,
            "height": HEIGHT,
            "focal_x": FOCAL / size,
            "focal_y": FOCAL / size,
            "c_x": (CX - WIDTH / 2) / size,
            "c_y": (CY - HEIGHT / 2) / size,
            "k1": K1,
            "k2": K2,
            "k3": K3,
            "p1": P1,
            "p2": P2,
        }
        shots = {}
        for k, image in enumerate(self.names):
            shots[image] = {
                "rotation": Rotation.from_matrix(rotations[k]).as_rotvec().tolist(),
                "translation": (-rotations[k] @ centres[k]).tolist(),
                "camera": "c",
                "gps_position": known[k].tolist(),
                "gps_dop": 5.0,
            }
        coordinates = {str(k): {"coordinates": place.tolist()} for k, place in enumerate(points, 1)}
        content = [{"cameras": {"c": camera}, "shots": shots, "points": coordinates}]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(content))
        lat, lon, h = self.origin
        reference = {"latitude": lat, "longitude": lon, "altitude": h}
        (folder / "reference_lla.json").write_text(json.dumps(reference))
        rows = ["OPENSFM_TRACKS_VERSION_v2"]
        for k, r in enumerate(self.observations.itertuples()):
            x = (r.x_px - WIDTH / 2) / size
            y = (r.y_px - HEIGHT / 2) / size
            rows.append(f"{r.image}\t{r.point}\t{k}\t{x!r}\t{y!r}\t0.001\t0\t0\t0\t-1\t-1")
        (folder / "tracks.csv").write_text("\n".join(rows) + "\n")

    def write_metashape(
        self,
        path,
        *,
        reference,
        shift=(0.0, 0.0, 0.0),
        known=None,
        chunk_scale=23.0,
        head=None,
    ):
        """An exported document; the chunk is earth-centred, moved by ``shift``, turned and scaled.

        Slave cameras of a rig have their place in the master's axes, in the chunk's units.
        """
        chunk_turn = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True).as_matrix()
        middle = ecef(*self.origin) + shift
        centres = self.centres + shift
        turns = self.cam_from_ecef()
        cameras = []
        markers: dict[str, list[str]] = {}
        for k, name in enumerate(self.names):
            pose = np.eye(4)
            pose[:3, :3] = chunk_turn.T @ turns[k].T
            pose[:3, 3] = chunk_turn.T @ (centres[k] - middle) / chunk_scale
            given = ""
            if known is not None:
                x, y, z = known[k].tolist()
                given = f'<reference x="{x!r}" y="{y!r}" z="{z!r}" enabled="true"/>'
            cameras.append(
                f'<camera id="{k}" sensor_id="0" component_id="0" label="{name}">'
                f"<transform>{text_of(pose)}</transform>{given}</camera>"
            )
            if head is not None:
                cameras.append(
                    f'<camera id="{100 + k}" sensor_id="1" master_id="{k}" component_id="0" '
                    f'label="{head.prefix}{name}"></camera>'
                )
            for r in self.seen_in(name).itertuples():
                place = f'<location camera_id="{k}" pinned="true" x="{r.x_px!r}" y="{r.y_px!r}"/>'
                markers.setdefault(r.point, []).append(place)
        calibration = (
            f'<resolution width="{WIDTH}" height="{HEIGHT}"/><calibration type="frame" '
            f'class="adjusted"><resolution width="{WIDTH}" height="{HEIGHT}"/><f>{FOCAL}</f>'
            f"<cx>{CX - WIDTH / 2}</cx><cy>{CY - HEIGHT / 2}</cy><k1>{K1}</k1><k2>{K2}"
            f"</k2><k3>{K3}</k3><p1>{P2}</p1><p2>{P1}</p2></calibration>"
        )
        sensors = f'<sensor id="0" label="c" type="frame">{calibration}</sensor>'
        if head is not None:
            step = text_of(np.asarray(head.place_m) / chunk_scale)
            sensors += (
                f'<sensor id="1" label="head" type="frame" master_id="0">{calibration}'
                f'<rotation locked="false">{text_of(head.master_from_head)}</rotation>'
                f'<translation locked="false">{step}</translation></sensor>'
            )
        labels = ""
        places = ""
        for k, locations in markers.items():
            labels += f'<marker id="{k}" label="{k}"/>'
            places += f'<marker marker_id="{k}">{"".join(locations)}</marker>'
        path.write_text(
            f'<document version="2.0.0"><chunk label="1" enabled="true"><sensors>{sensors}'
            '</sensors><components><component id="0"><transform><rotation locked="false">'
            f"{text_of(chunk_turn)}</rotation><translation>{text_of(middle)}</translation>"
            f"<scale>{chunk_scale}</scale></transform></component></components>"
            f"<cameras>{''.join(cameras)}</cameras><markers>{labels}</markers>"
            f'<frames><frame id="0"><markers>{places}</markers></frame></frames>'
            f"<reference>{reference}</reference></chunk></document>"
        )

    def in_grid(self, epsg):
        """Centres and points (x, y, h) in a map projection, and rotations from its axes.

        The azimuth of grid north is taken from two places 10 m apart.
        """
        import pyproj

        to_grid = pyproj.Transformer.from_crs(4979, epsg, always_xy=True)
        x, y = to_grid.transform(self.lon, self.lat)
        step_deg = np.degrees(10.0 / A)
        x_north, y_north = to_grid.transform(self.lon, self.lat + step_deg)
        meridian = np.arctan2(x_north - x, y_north - y)  # azimuth of true north in the grid
        rotations = []
        for turn, angle in zip(self.cam_from_enu, meridian, strict=True):
            east = [np.cos(angle), np.sin(angle), 0.0]
            north = [-np.sin(angle), np.cos(angle), 0.0]
            # The columns are grid east and north in terms of true east and north.
            enu_from_grid = np.array([east, north, [0.0, 0.0, 1.0]]).T
            rotations.append(turn @ enu_from_grid)
        px, py = to_grid.transform(self.point_lon, self.point_lat)
        centres = np.stack([x, y, self.h], axis=1)
        points = np.stack([px, py, self.point_h], axis=1)
        return centres, np.array(rotations), points

    def write_pix4d(self, folder, epsg, *, offset, leave_out=()):
        """The parameters of a project called ``survey``."""
        import pyproj

        centres, rotations, _ = self.in_grid(epsg)
        folder.mkdir(parents=True, exist_ok=True)
        lines = [
            "fileName imageWidth imageHeight ",
            "camera matrix K [3x3]",
            "radial distortion [3x1]",
            "tangential distortion [2x1]",
            "camera position t [3x1]",
            "camera rotation R [3x3]",
            "camera model m = K [R|-Rt] X",
            "",
        ]
        external = ["imageName X Y Z Omega Phi Kappa"]
        ties = []
        for name, centre, turn in zip(self.names, centres, rotations, strict=True):
            lines += [
                f"{name} {WIDTH} {HEIGHT}",
                f"{FOCAL} 0 {CX}",
                f"0 {FOCAL} {CY}",
                "0 0 1",
                f"{K1} {K2} {K3}",
                f"{P1} {P2}",
                text_of(centre - offset),
                *(text_of(row) for row in turn),
            ]
            omega, phi, kappa = textbook_opk(turn)
            x, y, z = centre
            external.append(f"{name} {x:.6f} {y:.6f} {z:.6f} {omega:.9f} {phi:.9f} {kappa:.9f}")
            ties.append(name.removesuffix(".JPG"))
            for r in self.seen_in(name).itertuples():
                ties.append(f"{1000 + int(r.point)} {r.x_px!r} {r.y_px!r} 2.5")
            ties.append("-99")
        files = {
            "calibrated_camera_parameters.txt": "\n".join(lines) + "\n",
            "calibrated_external_camera_parameters.txt": "\n".join(external) + "\n",
            "offset.xyz": " ".join(f"{v:.3f}" for v in offset) + "\n",
            "wkt.prj": pyproj.CRS.from_epsg(epsg).to_wkt("WKT1_GDAL"),
            "tp_pix4d.txt": "\n".join(ties) + "\n",
        }
        for name, text in files.items():
            if name not in leave_out:
                (folder / f"survey_{name}").write_text(text)

    def write_blocks_exchange(
        self,
        path,
        system,
        *,
        orientation="XRightYDown",
        angles=False,
        millimetres=False,
        known=None,
    ):
        """A block in ENU at the origin, in longitude and latitude, or in a map projection."""
        if system.startswith("ENU"):
            centres, rotations, points = self.in_enu()
        elif system == "WGS84":
            centres = np.stack([self.lon, self.lat, self.h], axis=1)
            rotations = self.cam_from_enu
            points = np.stack([self.point_lon, self.point_lat, self.point_h], axis=1)
        else:
            centres, rotations, points = self.in_grid(int(system.removeprefix("EPSG:")))
        # The rows of what turns a camera with x right, y down to the stated axes.
        to_stated = {
            "XRightYDown": np.eye(3),
            "XRightYUp": Y_UP_Z_BACK,
            "XLeftYDown": np.diag([-1.0, 1.0, -1.0]),
            "XDownYRight": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
        }[orientation]
        pixel_mm = 0.004

        def in_mm(right_px, down_px):
            """A place in the image, in the stated axes."""
            right = pixel_mm * right_px
            down = pixel_mm * down_px
            x_mm, y_mm, _ = (to_stated @ [right, down, 0.0]).tolist()
            return f"<xmm>{x_mm!r}</xmm><ymm>{y_mm!r}</ymm>"

        focal = f"<FocalLengthPixels>{FOCAL}</FocalLengthPixels>"
        principal = f"<x>{CX - 0.5}</x><y>{CY - 0.5}</y>"
        if millimetres:
            focal = (
                f"<SensorSize>{pixel_mm * WIDTH}</SensorSize>"
                f"<FocalLength>{pixel_mm * FOCAL}</FocalLength>"
            )
            principal = in_mm(CX - WIDTH / 2, CY - HEIGHT / 2)
        photos = []
        for k, (centre, turn) in enumerate(zip(centres, rotations, strict=True)):
            matrix = to_stated @ turn
            if angles:
                names = ["Omega", "Phi", "Kappa"]
                values = textbook_angles(matrix)
            else:
                names = [f"M_{i}{j}" for i in range(3) for j in range(3)]
                values = matrix.ravel().tolist()
            rotation = ""
            for name, value in zip(names, values, strict=True):
                rotation += f"<{name}>{value!r}</{name}>"
            x, y, z = centre.tolist()
            exif = ""
            if known is not None:
                lat, lon, h = known[k].tolist()
                exif = (
                    f"<ExifData><GPS><Latitude>{lat!r}</Latitude><Longitude>{lon!r}</Longitude>"
                    f"<Altitude>{h!r}</Altitude></GPS></ExifData>"
                )
            photos.append(
                f"<Photo><Id>{k + 5}</Id><ImagePath>D:\\flight\\{self.names[k]}</ImagePath><Pose>"
                f"<Rotation>{rotation}</Rotation><Center><x>{x!r}</x><y>{y!r}</y><z>{z!r}</z>"
                f"</Center></Pose>{exif}</Photo>"
            )
        ties = []
        for number, (x, y, z) in enumerate(points.tolist(), 1):
            rows = self.observations[self.observations["point"] == str(number)]
            seen = []
            for r in rows.itertuples():
                pixel = f"<x>{r.x_px - 0.5!r}</x><y>{r.y_px - 0.5!r}</y>"
                if millimetres:
                    pixel = in_mm(r.x_px - CX, r.y_px - CY)
                photo = self.names.index(r.image) + 5
                seen.append(f"<Measurement><PhotoId>{photo}</PhotoId>{pixel}</Measurement>")
            ties.append(
                f"<TiePoint><Position><x>{x!r}</x><y>{y!r}</y><z>{z!r}</z></Position>"
                f"{''.join(seen)}</TiePoint>"
            )
        path.write_text(
            '<BlocksExchange version="3.2"><SpatialReferenceSystems><SRS><Id>3</Id><Name>s</Name>'
            f"<Definition>{system}</Definition></SRS></SpatialReferenceSystems><Block><Name>b</Name>"
            "<SRSId>3</SRSId><Photogroups><Photogroup><Name>c</Name><ImageDimensions>"
            f"<Width>{WIDTH}</Width><Height>{HEIGHT}</Height></ImageDimensions>"
            f"<CameraModelType>Perspective</CameraModelType>{focal}"
            f"<CameraOrientation>{orientation}</CameraOrientation>"
            f"<PrincipalPoint>{principal}</PrincipalPoint><Distortion><K1>{K1}</K1>"
            f"<K2>{K2}</K2><K3>{K3}</K3><P1>{P2}</P1><P2>{P1}</P2></Distortion>"
            f"<AspectRatio>1</AspectRatio><Skew>0</Skew>{''.join(photos)}</Photogroup>"
            f"</Photogroups><ControlPoints/><TiePoints>{''.join(ties)}</TiePoints></Block>"
            "</BlocksExchange>"
        )


def textbook_angles(m):
    """omega, phi, kappa [deg] of a matrix from object to image, as Kraus and Wolf have it."""
    omega = np.arctan2(-m[2, 1], m[2, 2])
    phi = np.arcsin(np.clip(m[2, 0], -1.0, 1.0))
    kappa = np.arctan2(-m[1, 0], m[0, 0])
    return np.degrees([omega, phi, kappa]).tolist()


def textbook_opk(cam):
    """The same of a camera with x right, y down, z forward: the textbook's has y up, z back."""
    return textbook_angles(Y_UP_Z_BACK @ cam)


@dataclass
class SmallRig:
    """A second head: its place in the master's axes [m], and how it turns to these."""

    prefix: str
    place_m: tuple[float, float, float]
    master_from_head: np.ndarray


def text_of(values):
    """The numbers of an array, one behind the other."""
    return " ".join(map(repr, np.ravel(values).tolist()))


def largest_difference(stations, block):
    """Of positions [m] and attitudes [deg] of the stations of a run from the truth."""
    away = []
    turned = []
    truth = block.table()
    for row in stations.itertuples():
        *place, true_attitude = truth[row.image]
        station = ecef(row.lat_deg, row.lon_deg, row.h_ellipsoid_m)
        away.append(np.linalg.norm(station - ecef(*place)))
        quaternion = [row.q_x, row.q_y, row.q_z, row.q_w]
        attitude = Rotation.from_quat(quaternion).as_matrix()
        cosine = (np.trace(attitude @ true_attitude.T) - 1) / 2
        turned.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return max(away), max(turned)
