"""Makes Python on Linux lack what Python on Windows lacks, and refuse what Windows refuses.

The test writes a ``sitecustomize.py`` that calls `install`, so that the command line and the worker
processes it starts are all the same. It cannot be undone in a process: never call it in the tests'
own. What it takes away from the package (libraries made for Linux keep it): modules and functions
that only POSIX has, signals but SIGINT and SIGTERM, forking, file descriptors of folders. What it
refuses the package: to rename or remove an open file or a folder that holds one, to rename over a
file that exists (``os.rename``), to open a folder, to fsync a file that was opened for reading, to
make a symbolic link. A library does on Windows what its makers found to work there; here it does
what it does on Linux. Text files without a named encoding are an error in this package.
"""

import builtins
import os
import sys

MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")

# What os has on Linux and not on Windows; those that subprocess and site need stay.
OS_NAMES = (
    "chown chroot confstr copy_file_range ctermid eventfd fchdir fchmod fchown fdatasync fork "
    "forkpty fpathconf fstatvfs getegid geteuid getgid getgroups getloadavg getpgid getpgrp "
    "getpriority getrandom getresgid getresuid getsid getuid getxattr initgroups killpg lchown "
    "listxattr lockf mkfifo mknod memfd_create nice openpty pathconf pidfd_open pipe2 "
    "posix_fadvise posix_fallocate posix_spawn posix_spawnp pread preadv pwrite pwritev readv "
    "register_at_fork removexattr sched_getaffinity sched_getparam sched_get_priority_max "
    "sched_setaffinity sched_yield sendfile setegid seteuid setgid setgroups setpgid setpriority "
    "setsid setuid setxattr splice statvfs sync sysconf tcgetpgrp ttyname uname unshare wait "
    "wait3 wait4 waitid writev O_ASYNC O_CLOEXEC O_DIRECT O_DIRECTORY O_DSYNC O_NDELAY O_NOATIME "
    "O_NOCTTY O_NOFOLLOW O_NONBLOCK O_PATH O_RSYNC O_SYNC O_TMPFILE"
)

SIGNAL_NAMES = (
    "alarm getitimer pause pidfd_send_signal pthread_kill pthread_sigmask setitimer siginterrupt "
    "sigpending sigtimedwait sigwait sigwaitinfo SIGALRM SIGBUS SIGCHLD SIGCLD SIGCONT SIGHUP "
    "SIGIO SIGIOT SIGKILL SIGPIPE SIGPOLL SIGPROF SIGPWR SIGQUIT SIGRTMAX SIGRTMIN SIGSTKFLT "
    "SIGSTOP SIGSYS SIGTRAP SIGTSTP SIGTTIN SIGTTOU SIGURG SIGUSR1 SIGUSR2 SIGVTALRM SIGWINCH "
    "SIGXCPU SIGXFSZ SIG_BLOCK SIG_SETMASK SIG_UNBLOCK"
)


def install():
    """Take away, in this process and for good, what Windows does not have."""
    os.supports_dir_fd.clear()  # before shutil is imported: it chooses its rmtree by them
    os.supports_fd.clear()
    remove_names()
    refuse_what_an_open_file_forbids()
    spawn_only()
    name_every_encoding()


def is_ours(module):
    return str(module).split(".")[0] in ("unbend", "__main__")


def called_by_us():
    """Whether the package called, itself or through the standard library (pathlib, shutil)."""
    frame = sys._getframe(1)
    while frame is not None:
        module = str(frame.f_globals.get("__name__")).split(".")[0]
        if module != __name__ and module not in sys.stdlib_module_names - {"__main__"}:
            return is_ours(module)
        frame = frame.f_back
    return False


def remove_names():
    import mmap
    import signal
    import tempfile
    import time

    real_import = builtins.__import__

    def import_module(name, within=None, *arguments, **keywords):
        if name in MODULES and is_ours((within or {}).get("__name__")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real_import(name, within, *arguments, **keywords)

    builtins.__import__ = import_module
    hide(os, OS_NAMES.split())
    hide(signal, SIGNAL_NAMES.split())
    hide(time, ["clock_gettime", "clock_gettime_ns", "pthread_getcpuclockid", "tzset"])
    hide(mmap, [name for name in dir(mmap) if name.startswith(("MAP_", "MADV_", "PROT_"))])
    tempfile.TemporaryFile = tempfile.NamedTemporaryFile


def hide(owner, names):
    """Move names out of a module, to where only libraries get them."""
    hidden = {name: vars(owner).pop(name) for name in names if name in vars(owner)}

    def lookup(name):
        if name not in hidden or is_ours(sys._getframe(1).f_globals.get("__name__")):
            raise AttributeError(f"module {owner.__name__!r} has no attribute {name!r}")
        return hidden[name]

    owner.__getattr__ = lookup  # type: ignore[method-assign]


def open_files():
    """Paths that this process holds open or mapped; not of files that have no name any more."""
    paths = set()
    for number in _real_listdir("/proc/self/fd"):
        try:
            paths.add(os.readlink(f"/proc/self/fd/{number}"))
        except OSError:  # closed meanwhile, as that of the listing itself
            continue
    with _real_open("/proc/self/maps", encoding="utf-8") as maps:
        paths.update(line[at:].rstrip() for line in maps if (at := line.find("/")) > 0)
    return {path for path in paths if not path.endswith(" (deleted)")}


_real_listdir = os.listdir
_real_open = open


def refuse_what_an_open_file_forbids():
    real_open = os.open
    real_fsync = os.fsync
    real_symlink = os.symlink

    def refuse_if_open(path):
        here = os.path.abspath(os.fspath(path))
        for held in open_files():
            if held == here or held.startswith(here + "/"):
                raise PermissionError(13, f"[WinError 32] {held} is open in this process", here)

    def guarded(function, *, over, paths):
        def call(*arguments, **keywords):
            if not called_by_us():
                return function(*arguments, **keywords)
            for path in arguments[:paths]:
                refuse_if_open(path)
            if not over and os.path.lexists(arguments[1]):
                raise FileExistsError(17, "[WinError 183] it exists", arguments[1])
            return function(*arguments, **keywords)

        return call

    os.replace = guarded(os.replace, over=True, paths=2)
    os.rename = guarded(os.rename, over=False, paths=2)
    os.unlink = os.remove = guarded(os.unlink, over=True, paths=1)
    os.rmdir = guarded(os.rmdir, over=True, paths=1)

    def open_no_folder(path, *arguments, **keywords):
        if called_by_us() and os.path.isdir(path):
            raise PermissionError(13, "a folder has no file descriptor", path)
        return real_open(path, *arguments, **keywords)

    def fsync_what_is_written(file):
        if not called_by_us():
            real_fsync(file)
            return
        number = file if isinstance(file, int) else file.fileno()
        with _real_open(f"/proc/self/fdinfo/{number}", encoding="ascii") as info:
            flags = next(int(line.split()[1], 8) for line in info if line.startswith("flags:"))
        if flags & 3 == os.O_RDONLY:
            raise OSError(9, "a file that was opened for reading cannot be flushed")
        real_fsync(number)

    def no_symlink(source, target, *arguments, **keywords):
        if not called_by_us():
            return real_symlink(source, target, *arguments, **keywords)
        raise OSError(1314, "a required privilege is not held by the client", source, None, target)

    os.open, os.fsync, os.symlink = open_no_folder, fsync_what_is_written, no_symlink


def spawn_only():
    import multiprocessing
    import multiprocessing.process

    multiprocessing.set_start_method("spawn")
    whole = multiprocessing.get_context

    def get_context(method=None):
        if method not in (None, "spawn"):
            raise ValueError(f"cannot find context for {method!r}")
        return whole(method)

    multiprocessing.get_context = get_context  # type: ignore[assignment]
    multiprocessing.get_all_start_methods = lambda: ["spawn"]
    process = multiprocessing.process.BaseProcess
    process.kill = process.terminate


def name_every_encoding():
    import warnings

    warnings.filterwarnings("error", category=EncodingWarning, module=r"unbend(\.|$)")
