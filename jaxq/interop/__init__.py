"""Other people's environments and libraries, each imported when it is asked for."""
