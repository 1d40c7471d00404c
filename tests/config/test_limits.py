"""The limits of every number of the mission file, and its unit: what a user may rely on.

They keep out what is no survey (a station 60 km high, a thermometer off by 300 K, pascals under a
key in hectopascals), and nothing that is one.
"""

from pydantic.fields import FieldInfo

from unbend.config.schema import all_sections

LIMITS = """
MissionSection.undulation_m                   >= -120, <= 100             m
LogSection.max_gap_s                          > 0, <= 60                  s
LocalOrigin.lat_deg                           >= -90, <= 90               deg
LocalOrigin.lon_deg                           >= -180, <= 360             deg
LocalOrigin.h_ellipsoid_m                     >= -500, <= 50000           m
CameraSection.width_px                        > 0, <= 1e+06               px
CameraSection.height_px                       > 0, <= 1e+06               px
CameraSection.cx_px                           >= -1e+06, <= 1e+06         px
CameraSection.cy_px                           >= -1e+06, <= 1e+06         px
MetricSection.focal_mm                        >= 1, <= 5000               mm
MetricSection.pixel_um                        at least 2, at most 2       um
MetricSection.format_mm                       at least 2, at most 2       mm
MetricSection.ppa_mm                          at least 2, at most 2       mm
MetricSection.radius_mm                       > 0                         mm
MetricDistortion.k0                           >= -10, <= 10               1
MetricDistortion.k1                           >= -10, <= 10               mm^-2
MetricDistortion.k2                           >= -10, <= 10               mm^-4
MetricDistortion.k3                           >= -10, <= 10               mm^-6
MetricDistortion.k4                           >= -10, <= 10               mm^-8
MetricDistortion.p1                           >= -10, <= 10               mm^-1
MetricDistortion.p2                           >= -10, <= 10               mm^-1
MetricDistortion.b1                           >= -0.05, <= 0.05           1
MetricDistortion.b2                           >= -0.05, <= 0.05           1
MetricTable.rows                              at least 3                  um
DistortionSection.k1                          >= -1e+15, <= 1e+15         1
DistortionSection.k2                          >= -1e+15, <= 1e+15         1
DistortionSection.k3                          >= -1e+15, <= 1e+15         1
DistortionSection.p1                          >= -1e+15, <= 1e+15         1
DistortionSection.p2                          >= -1e+15, <= 1e+15         1
WindowSection.normal                          at least 3, at most 3       1
CabinSection.relative_humidity                >= 0, <= 1                  1
CabinSection.sigma_pressure_hpa               >= 0, <= 300                hPa
CabinSection.sigma_temperature_k              >= 0, <= 50                 K
OpeningSection.warmer_k                       >= -30, <= 60               K
OpeningSection.pressure_excess_hpa            >= -100, <= 100             hPa
OpeningSection.sigma_warmer_k                 >= 0, <= 50                 K
OpeningSection.sigma_pressure_excess_hpa      >= 0, <= 100                hPa
OpeningSection.normal                         at least 3, at most 3       1
LensSection.dc_dp_px_per_hpa                  >= -10, <= 10               px/hPa
LensSection.dc_dt_px_per_k                    >= -10, <= 10               px/K
LensReference.pressure_hpa                    >= 100, <= 1200             hPa
LensReference.temperature_c                   >= -60, <= 60               degC
MountSection.roll_deg                         >= -720, <= 720             deg
MountSection.pitch_deg                        >= -720, <= 720             deg
MountSection.yaw_deg                          >= -720, <= 720             deg
MountSection.lever_arm_m                      at least 3, at most 3       m
MountSection.sigma_tilt_deg                   >= 0, <= 45                 deg
MountSection.sigma_yaw_deg                    >= 0, <= 180                deg
CsvEvents.delay_s                             >= -86400, <= 86400         s
PositionEvents.delay_s                        >= -10, <= 10               s
ImportTime.week                               >= 0, <= 9999               1
FirstImage.event                              >= 1                        1
StationsSection.max_sigma_horizontal_m        > 0                         m
StationsSection.max_sigma_height_m            > 0                         m
StationsSection.max_sigma_tilt_deg            > 0, <= 45                  deg
OrientationSection.convergence_deg            >= -30, <= 30               deg
OrientationSection.sigma_horizontal_m         >= 0, <= 10000              m
OrientationSection.sigma_height_m             >= 0, <= 10000              m
OrientationSection.sigma_tilt_deg             >= 0, <= 45                 deg
OrientationSection.sigma_yaw_deg              >= 0, <= 180                deg
KnownPositions.sigma_m                        > 0, <= 1000                m
GroundSection.home_h_msl_m                    >= -600, <= 10000           m
GroundSection.sigma_m                         >= 0, <= 10000              m
AtmosphereSection.wavelength_m                >= 3e-07, <= 1.7e-06        m
AtmosphereSection.co2_ppm                     >= 0, <= 2000               ppm
SoundingSection.station_h_msl_m               >= -500, <= 6000            m
SurfaceSection.h_msl_m                        >= -500, <= 6000            m
SurfaceSection.pressure_hpa                   > 0                         hPa
SurfaceSection.distance_km                    >= 0, <= 2000               km
WeatherModelSection.member                    >= 0                        1
ThermometerSection.bias_k                     >= -30, <= 30               K
ThermometerSection.sigma_bias_k               >= 0.01, <= 30              K
ThermometerSection.lag_s                      >= 0, <= 90                 s
ThermometerSection.sigma_lag_s                >= 0.1, <= 90               s
ThermometerSection.transient_k                >= -30, <= 30               K
ThermometerSection.sigma_transient_k          >= 0.01, <= 30              K
ThermometerSection.recovery                   >= 0, <= 1.1                1
ThermometerSection.sigma_recovery             >= 0.005, <= 1              1
ThermometerSection.sigma_drift_k              >= 0.01, <= 30              K
BarometerSection.offset_hpa                   >= -30, <= 30               hPa
BarometerSection.sigma_offset_hpa             >= 0.01, <= 30              hPa
BarometerSection.sigma_scale                  >= 1e-05, <= 0.1            1
HygrometerSection.bias                        >= -0.5, <= 0.5             1
HygrometerSection.sigma_bias                  >= 0.001, <= 0.5            1
GnssSection.sigma_height_m                    >= 0.01, <= 100             m
RefractionSection.radius_m                    >= 6.2e+06, <= 6.5e+06      m
OutputSection.batch_rows                      >= 1000, <= 2e+06           1
"""

SIGNS = {
    "gt": ">",
    "ge": ">=",
    "lt": "<",
    "le": "<=",
    "min_length": "at least",
    "max_length": "at most",
}


def limits_of(field: FieldInfo):
    """The limits of a key as the table has them."""
    limits = []
    for part in field.metadata:
        for name, sign in SIGNS.items():
            bound = getattr(part, name, None)
            if bound is not None:
                limits.append(f"{sign} {bound:g}")
    return ", ".join(limits)


def unit_of(field: FieldInfo):
    extra = field.json_schema_extra
    return extra.get("unit") if isinstance(extra, dict) else None


def test_the_limits_of_every_number_are_those_of_the_table():
    limits = [
        " ".join([f"{name}.{key}", limits_of(field), str(unit_of(field))])
        for name, section in all_sections().items()
        for key, field in section.model_fields.items()
        if limits_of(field) and unit_of(field) is not None
    ]
    expected = [" ".join(line.split()) for line in LIMITS.strip().splitlines()]
    assert sorted(limits) == sorted(expected)
