"""What commands other than `unbend run` do with missions and their results."""
