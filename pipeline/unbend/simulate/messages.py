"""Messages of the simulation: the meaning of each code, and one function for each error."""

from unbend.errors import Code, ConfigError, MissionError, PhysicsError

SIM_ODE = Code(
    "SIM-ODE",
    means="The integration of a simulated ray did not succeed.",
    effect="The simulation stops.",
    remedy="Report it to the authors.",
)


def not_integrated(*, what: str, answer: str) -> PhysicsError:
    """The integration of ``what`` failed; ``answer``: the message of the integrator."""
    return PhysicsError(
        SIM_ODE, "the integration of the {what} failed: {answer}", what=what, answer=answer
    )


SIM_OPTION = Code(
    "SIM-OPTION",
    means="An option of the simulation is out of range.",
    effect="The command is refused.",
    remedy="Choose a value in the named range.",
)


def sim_option(*, where: object, name: str, value: str, low: float, high: float) -> ConfigError:
    """An option of the simulation is out of range."""
    return ConfigError(
        SIM_OPTION,
        "{name} is {value}, outside {low} to {high}",
        where=where,
        name=name,
        value=value,
        low=low,
        high=high,
        remedy="choose {name} between {low} and {high}",
    )


SIM_PATH = Code(
    "SIM-PATH",
    means="The simulated flight lines end too near to the airfield.",
    effect="The simulation stops.",
    remedy="Choose another height or seed.",
)


def path_too_near(*, distance_m: float) -> PhysicsError:
    """The lines end so near to the field that no circle and tangent lead back to it."""
    return PhysicsError(
        SIM_PATH,
        "the lines end {distance_m:.0f} m from the airfield: too near",
        distance_m=distance_m,
    )


SIM_POINTS = Code(
    "SIM-POINTS",
    means="No simulated ground point is seen by enough images.",
    effect="The simulation stops.",
    remedy="Use more exposures per line, or a shorter focal length.",
)


def sim_points(*, fewest: int, number: int) -> MissionError:
    """No ground point is seen by at least ``fewest`` of the ``number`` images."""
    return MissionError(
        SIM_POINTS,
        "no ground point is seen by {fewest} of the {number} images",
        fewest=fewest,
        number=number,
        remedy="use more exposures per line, or a shorter focal length",
    )
