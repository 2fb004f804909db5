"""Recorded signals: their sample period, gaps and partners, joined on one clock."""
