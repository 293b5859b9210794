"""The physical effects physid knows: one file per family, one table that lists them all."""
