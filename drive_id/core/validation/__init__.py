"""Is the identified model right? Open-loop simulation of the current; MAD and NRMSE."""
