"""pycolmap as the adjustment of a block: a model that grows by cameras, images and points."""

from collections import defaultdict
from collections.abc import Hashable

import pycolmap


class Adjustment:
    """A model of pycolmap and what of it is constant; points are known by the test's names."""

    def __init__(self):
        self.model = pycolmap.Reconstruction()
        self.config = pycolmap.BundleAdjustmentConfig()
        self.options = pycolmap.BundleAdjustmentOptions()
        self.options.print_summary = False
        self.tracks: dict[Hashable, list[pycolmap.TrackElement]] = defaultdict(list)
        self.numbers: dict[Hashable, int] = {}

    def add_camera(self, camera, *, constant=True):
        self.model.add_camera_with_trivial_rig(camera)
        if constant:
            self.config.set_constant_cam_intrinsics(camera.camera_id)

    def add_image(
        self,
        name,
        camera_id,
        pixels,
        points,
        rotation,
        centre,
    ):
        """An image with a pixel (k, 2) of each of these points, and its rotation to the camera."""
        number = self.model.num_images() + 1
        image = pycolmap.Image(name=name, keypoints=pixels, camera_id=camera_id, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        self.model.add_image_with_trivial_frame(image, pose)
        self.config.add_image(number)
        for keypoint, point in enumerate(points):
            self.tracks[point].append(pycolmap.TrackElement(number, keypoint))
        return image

    def add_point(self, point, start, *, constant=False):
        """A point of the images that were added."""
        number = self.model.add_point3D(start, pycolmap.Track(self.tracks[point]))
        self.numbers[point] = number
        if constant:
            self.config.add_constant_point(number)

    def converge_tightly(self):
        """To micrometres: by default pycolmap stops at a millimetre."""
        self.options.ceres.solver_options.gradient_tolerance = 1e-10
        self.options.ceres.solver_options.function_tolerance = 1e-12

    def solve(self, solver=None):
        """Adjust, by pycolmap's usual solver or another one."""
        if solver is None:
            solver = pycolmap.create_default_bundle_adjuster(
                self.options,
                self.config,
                self.model,
            )
        solver.solve()

    def position(self, point):
        """Where a point is now."""
        return self.model.points3D[self.numbers[point]].xyz
