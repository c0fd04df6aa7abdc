"""bisque_start.py - where the programs of the package start, before numpy and the libraries are loaded."""
import importlib.util
import os
import signal
import sys

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
INTERRUPTED = "bisque-asset: interrupted; the same command goes on from here\n"


def end_at_once(*_):
    """Ends bisque-asset where it would print a traceback otherwise. Its children end with it."""
    try:
        os.write(2, INTERRUPTED.encode())
    finally:
        os._exit(75)


def catch(handler):
    """Sets the handler of signals, but of those that the parent ignores (nohup, a background job)."""
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def die_with_parent():
    """If BSQ_PARENT has the process id of the parent, ends this process when the parent dies."""
    parent = os.environ.get("BSQ_PARENT")
    if parent:
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGTERM, 0, 0, 0)  # PR_SET_PDEATHSIG
        if str(os.getppid()) != parent:
            os._exit(75)


def asset():
    """The program bisque-asset."""
    catch(end_at_once)
    die_with_parent()
    from bisque.command import main

    return main()


def main():
    """Becomes the program of the package that has the name of this one, such as bisque-bake."""
    package = os.path.dirname(importlib.util.find_spec("bisque").origin)
    program = os.path.join(package, "bin", os.path.basename(sys.argv[0]))
    os.execv(program, [program, *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(asset())
