"""Logs that are not bags: columns of CSV, Parquet, MATLAB, MDF, TDMS and HDF5 files, by libraries of the extra containers."""
