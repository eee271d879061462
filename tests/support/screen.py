import json


class NoScreen:
    """A console nobody looks at."""

    def offer(self, snapshot):
        json.dumps(snapshot)

    def close(self):
        """Nothing to close."""
