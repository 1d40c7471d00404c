"""Rows of the matrix in which `sigma` works on some observations at a time.

One small matrix stays in a core's cache, and the compiler sees that its rows do not overlap: loops
over it then run four observations at a time. The first rows, `IDEAL_U` to `CAMERA_HEIGHT`, are
those of a matrix of rays.
"""

from unbend.refraction.kernels.columns import RAY_ROWS

COLUMNS_TOGETHER = 256  # observations at a time

# The observations.
X_PX = RAY_ROWS
Y_PX = RAY_ROWS + 1
R_C = RAY_ROWS + 2  # refraction angle [rad]
H_G = RAY_ROWS + 3  # height of the target [m]
SIGMA_H_G = RAY_ROWS + 4  # sigma of that height [m]
ONE_IF_KNOWN = RAY_ROWS + 5  # factor of all results: 1, or NaN where no sigma is known
DROP = RAY_ROWS + 6  # height of the camera above the target [m]
SLOPE_UU = RAY_ROWS + 7  # derivatives of the distortion: du_d/du,
SLOPE_UV = RAY_ROWS + 8  # du_d/dv = dv_d/du,
SLOPE_VV = RAY_ROWS + 9  # dv_d/dv

# Positions on the axes of `AirTables`, in nodes.
WAY_POSITION = RAY_ROWS + 10
COARSE_POSITION = RAY_ROWS + 11  # on the axis of coarser ways
INCIDENCE_POSITION = RAY_ROWS + 12
GROUND_POSITION = RAY_ROWS + 13  # on that of heights of ``refractivity``

# What the air does to the ray, interpolated in the tables.
SIGMA_BY_TANGENT = RAY_ROWS + 14  # sigma of R_c / tan(zeta) [rad]
SLOPE_BY_SECANT2 = RAY_ROWS + 15  # dR/dzeta cos^2(zeta)
MODE_BY_TANGENT = RAY_ROWS + 16  # dR/ds / tan(zeta), s the parameter of the leading mode
SIGMA_AIR_X = RAY_ROWS + 17  # sigma of x of `uncertainty.sigmas`, not a coordinate of pixels
SHARED_AIR_XY = RAY_ROWS + 18  # covariance of that x with y, over sigma of y
N_GROUND = RAY_ROWS + 19  # N at the target

# Results: the columns of `Sigmas`, in their order.
FIRST_RESULT = RAY_ROWS + 20
SIGMA_R_C = FIRST_RESULT
AIR_DX = FIRST_RESULT + 1
AIR_DY = FIRST_RESULT + 2
STATION_DX = FIRST_RESULT + 3
STATION_DY = FIRST_RESULT + 4
GROUND_DX = FIRST_RESULT + 5
GROUND_DY = FIRST_RESULT + 6
SIGMA_R_CC = FIRST_RESULT + 7
CABIN_DX = FIRST_RESULT + 8
CABIN_DY = FIRST_RESULT + 9
DX_DS = FIRST_RESULT + 10
DY_DS = FIRST_RESULT + 11
DX_DNCC = FIRST_RESULT + 12
DY_DNCC = FIRST_RESULT + 13
RESULTS = 14

ALL_ROWS = FIRST_RESULT + RESULTS
