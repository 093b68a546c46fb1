"""Recordings as pictures: values in colours, panels of them on a sheet, sheets as a video."""
