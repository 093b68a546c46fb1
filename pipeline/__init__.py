"""The method, as pure functions over numpy arrays. Imported as ``vlmm_log.pipeline``."""
