NO_THREADS = """
import threading
def refused(thread):
    raise RuntimeError("can't start new thread")
threading.Thread.start = refused
"""
"""Lines of a script that lets it start no thread, as a limit of processes does."""
