"""A mission without its log, and its stations and points as other programs would write them."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.small_block import ecef, enu_axes

CABIN = {
    "pressure_hpa": 812.0,
    "temperature_c": 21.0,
    "relative_humidity": 0.3,
}
PLACE = ["lat_deg", "lon_deg", "h_ellipsoid_m"]


def matrices(quaternions):
    """(n, 3, 3) of v_camera = R(q) v_enu; the scalar of a quaternion is its first number."""
    rotation = Rotation.from_quat(quaternions, scalar_first=True)
    return rotation.as_matrix()


def earth_centred(lat_deg, lon_deg, h):
    """(n, 3) coordinates, and (n, 3, 3) from them to east, north, up."""
    centres = ecef(lat_deg, lon_deg, np.asarray(h))
    axes = [enu_axes(lat, lon) for lat, lon in zip(lat_deg, lon_deg, strict=True)]
    return centres, np.array(axes)


def in_enu(stations, points, origin):
    """Positions (n, 3), rotations (n, 3, 3) to the camera and points (p, 3), about one place."""
    lat, lon, _ = origin
    axes = enu_axes(lat, lon)
    zero = ecef(*origin)
    centres, enu = earth_centred(*stations[PLACE].to_numpy().T)
    places = ecef(*points[PLACE].to_numpy().T)
    quaternions = stations[["q_w", "q_x", "q_y", "q_z"]]
    camera_from_enu = matrices(quaternions)
    rotations = camera_from_enu @ enu @ axes.T
    return (centres - zero) @ axes.T, rotations, (places - zero) @ axes.T


def write_colmap(
    folder,
    cameras,
    stations,
    observations,
    points,
    *,
    origin,
    text=False,
    without_point=frozenset(),
):
    """A sparse model by pycolmap; the rows of ``without_point`` are keypoints of no point3D.

    ``cameras`` has the model, width, height and parameters of each by its name. Returns the
    numbers of the points by name.
    """
    import pycolmap

    block = pycolmap.Reconstruction()
    camera_ids = {name: number for number, name in enumerate(cameras, 1)}
    for name, (model, width, height, params) in cameras.items():
        camera = pycolmap.Camera(
            model=model,
            width=width,
            height=height,
            params=params,
            camera_id=camera_ids[name],
        )
        block.add_camera_with_trivial_rig(camera)

    centres, rotations, places = in_enu(stations, points, origin)
    tracks = {name: pycolmap.Track() for name in points["point"]}
    for k, station in enumerate(stations.itertuples()):
        rows = observations[observations["image"] == station.image]
        image = pycolmap.Image(
            name=station.image,
            keypoints=rows[["x_px", "y_px"]].to_numpy(),
            camera_id=camera_ids[station.camera],
            image_id=k + 1,
        )
        turn = pycolmap.Rotation3d(rotations[k])
        pose = pycolmap.Rigid3d(turn, -rotations[k] @ centres[k])
        block.add_image_with_trivial_frame(image, pose)
        for keypoint, (row, point) in enumerate(rows["point"].items()):
            if row not in without_point:
                tracks[point].add_element(k + 1, keypoint)

    numbers = {}
    for (name, track), place in zip(tracks.items(), places, strict=True):
        if track.length():
            numbers[name] = block.add_point3D(place, track)
    folder.mkdir(parents=True, exist_ok=True)
    if text:
        block.write_text(str(folder))
    else:
        block.write_binary(str(folder))
    return numbers
