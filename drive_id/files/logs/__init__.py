"""Logs that are not bags: columns of CSV, Parquet, MATLAB, MDF, TDMS and HDF5 files."""
