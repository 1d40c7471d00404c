"""GRIB of messages that tests state by ecCodes' keys."""


def write_grib(path, messages, edition=2, values=None):
    """Messages on pressure levels from ecCodes' sample, each with these keys, as "level=850"."""
    import eccodes

    with path.open("wb") as file:
        for keys in messages:
            message = eccodes.codes_grib_new_from_samples(f"regular_ll_pl_grib{edition}")
            eccodes.codes_set_key_vals(message, keys)
            if values is not None:
                eccodes.codes_set_values(message, values)
            eccodes.codes_write(message, file)
            eccodes.codes_release(message)
