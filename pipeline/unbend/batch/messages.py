"""Refusals of runs, campaigns, processes, folders and object storage: codes and their words."""

from collections.abc import Sequence

from unbend.config.messages import URL_INVALID
from unbend.errors import (
    Code,
    ConfigError,
    InputError,
    MissionError,
    OutputInUseError,
    StorageError,
)
from unbend.flight.messages import IMAGES_OTHER
from unbend.tables.imports.blocks.messages import INPUT_MISSING
from unbend.tables.manifest.messages import MANIFEST_UNREADABLE

# Inputs

INPUT_FOLDER = Code(
    "INPUT-FOLDER",
    means="The mission file names a folder in the place of a file.",
    effect="The mission is refused.",
    remedy="Name the file in the folder; paths are relative to the mission file.",
)
INPUT_UNREADABLE = Code(
    "INPUT-UNREADABLE",
    means="A file cannot be read.",
    effect="The mission is refused.",
    remedy="Correct its permissions.",
)
INPUT_CHANGED = Code(
    "INPUT-CHANGED",
    means="Another program changed or replaced an input file during the run.",
    effect="The results are not kept.",
    remedy="Run again when no program writes to it.",
)


def input_missing(*, role: str, path: str, key: str) -> InputError:
    """A file or folder of a mission is not there; ``key`` of the mission file names it."""
    return InputError(
        INPUT_MISSING,
        "the {role} file is not there",
        where=path,
        remedy="check {key} in the mission file; paths are relative to it",
        role=role,
        key=key,
    )


def folder_as_input(*, role: str, path: str, key: str, meant: str = "") -> InputError:
    """A folder in the place of a file; ``meant`` is the only file in it that fits, or empty."""
    remedy = "name the file in it: {key} in the mission file"
    if meant:
        remedy = "perhaps {key}: {meant}"
    elif role == "observations":
        remedy += "; the folder of a block of another program needs observations.format"
    return InputError(
        INPUT_FOLDER,
        "the {role} path is a folder, not a file",
        where=path,
        remedy=remedy,
        role=role,
        key=key,
        meant=meant,
    )


def results_as_input(*, role: str, path: str, key: str, run: str) -> InputError:
    """A folder of the results of a run in the place of a file."""
    if role == "observations":
        return InputError(
            INPUT_FOLDER,
            "the {role} path is the folder of the results of a run: its points are corrected "
            "already",
            where=path,
            remedy="name the table of the measurements: {key} in the mission file",
            role=role,
            key=key,
        )
    return InputError(
        INPUT_FOLDER,
        "the {role} path is the folder of the results of a run, not a file",
        where=path,
        remedy="name the {role} file: {key} in the mission file; {run} has results only",
        role=role,
        key=key,
        run=run,
    )


def input_unreadable(*, path: str, error: str) -> InputError:
    """The operating system does not let an input be read."""
    return InputError(
        INPUT_UNREADABLE, "{error}", where=path, remedy="correct its permissions", error=error
    )


def input_changed(*, role: str, path: str) -> InputError:
    """An input is not what it was when the run began."""
    return InputError(
        INPUT_CHANGED,
        "another program changed or replaced the {role} file during the run",
        where=path,
        remedy="run again when no program writes to it",
        role=role,
    )


# Output folders and what is in them

OUTPUT_IN_USE = Code(
    "OUTPUT-IN-USE",
    means=(
        "Another process is writing to the output folder. Or it has published another run in "
        "object storage in the meantime."
    ),
    effect="The mission is not run, or its results are not published (exit code 4).",
    remedy="Wait for it, or choose another output.path.",
)
OUTPUT_OTHER = Code(
    "OUTPUT-OTHER",
    means="The output folder contains the results of another mission.",
    effect="The mission is refused.",
    remedy="Give each mission a different output.path.",
)
OUTPUT_OVER_INPUT = Code(
    "OUTPUT-OVER-INPUT",
    means="An input is among the results that a run replaces.",
    effect="The mission is refused.",
    remedy="Move it elsewhere, or choose another output.path.",
)
OUTPUT_SHARED = Code(
    "OUTPUT-SHARED",
    means="Two missions write to one folder.",
    effect="The second is refused.",
    remedy="Give each mission a different folder.",
)
STORAGE_LOCK = Code(
    "STORAGE-LOCK",
    means="The output folder cannot be locked.",
    effect="The mission is not run (exit code 5).",
    remedy="Choose an output.path on a disk that can lock files.",
)
STORAGE_NOT_OURS = Code(
    "STORAGE-NOT-OURS",
    means="Files in the output folder would be replaced, and nothing shows that unbend wrote them.",
    effect="The mission, or the campaign, is not run (exit code 5).",
    remedy="Choose another output.path or campaign.output, or remove these files.",
)
STORAGE_SYMLINK = Code(
    "STORAGE-SYMLINK",
    means="A result in the output folder is a symbolic link.",
    effect="The mission is not run (exit code 5).",
    remedy="Remove the link.",
)
VERIFY_NO_MANIFEST = Code(
    "VERIFY-NO-MANIFEST",
    means="There is no manifest: no run has finished in this folder.",
    effect="The command ends with exit code 5.",
    remedy="Run the mission.",
)
VERIFY_DAMAGED = Code(
    "VERIFY-DAMAGED",
    means="Results are incomplete, or were changed.",
    effect="The command ends with exit code 5.",
    remedy="Run the mission again.",
)


def output_in_use(*, path: str, lock: str, holder: str) -> OutputInUseError:
    """Another process holds the lock of a folder of results; ``holder`` says which, in words."""
    return OutputInUseError(
        OUTPUT_IN_USE,
        "another process is writing to this folder: {holder} has locked {lock}",
        where=path,
        remedy="wait for it or end it, or choose another output.path",
        lock=lock,
        holder=holder,
    )


def published_meanwhile(*, url: str) -> OutputInUseError:
    """Another run was published at a URL after this one began."""
    return OutputInUseError(
        OUTPUT_IN_USE,
        "another run was published there in the meantime; this run was not published",
        where=url,
        remedy="decide which of the two runs is needed, and run it again",
    )


def output_of_other_mission(*, path: str, other: str, name: str) -> ConfigError:
    """The manifest in the output folder is that of a mission of another name."""
    return ConfigError(
        OUTPUT_OTHER,
        "the folder contains the results of mission {other}, and {name} would replace them",
        where=path,
        remedy="give each mission a different output.path, or remove the other results",
        other=other,
        name=name,
    )


def output_over_input(*, role: str, path: str, output: str) -> ConfigError:
    """An input, or the mission file, lies where results will be."""
    return ConfigError(
        OUTPUT_OVER_INPUT,
        "the {role} file is among the results that a run replaces in {output}",
        where=path,
        remedy="move it elsewhere, or choose another output.path",
        role=role,
        output=output,
    )


def output_shared(*, first: str) -> ConfigError:
    """An earlier mission of the command writes to the same folder."""
    return ConfigError(
        OUTPUT_SHARED,
        "writes to the same folder as {first}",
        where="output.path",
        remedy="give each mission a different folder",
        first=first,
    )


def folder_not_lockable(*, path: str, error: str) -> StorageError:
    """The file system of a folder has no locks."""
    return StorageError(
        STORAGE_LOCK,
        "the folder cannot be locked: {error}",
        where=path,
        remedy="choose an output.path on a disk that can lock files",
        error=error,
    )


def files_not_ours(*, path: str, results: Sequence[str]) -> StorageError:
    """Files are named like results, and nothing says that unbend wrote them."""
    return StorageError(
        STORAGE_NOT_OURS,
        (
            "{results} would be replaced, but there is no manifest.json that shows that unbend "
            "wrote them"
        ),
        where=path,
        remedy="choose another output.path for the results, or remove these files",
        results=", ".join(results),
    )


def pages_not_ours(*, path: str, pages: Sequence[str]) -> StorageError:
    """Files are named like page and table of a campaign, and unbend did not write them."""
    return StorageError(
        STORAGE_NOT_OURS,
        "{pages} would be replaced, but unbend did not write that",
        where=path,
        remedy="choose another campaign.output, or remove these files",
        pages=" and ".join(pages),
    )


def result_is_link(*, path: str, name: str) -> StorageError:
    """A symbolic link stands where a result will be written."""
    return StorageError(
        STORAGE_SYMLINK,
        "{name} is a symbolic link",
        where=path,
        remedy="remove it: results are never written through a link",
        name=name,
    )


def manifest_unreadable(*, path: str, error: str) -> StorageError:
    """The manifest cannot be read, or is no JSON."""
    return StorageError(
        MANIFEST_UNREADABLE,
        "the manifest cannot be read: {error}",
        where=path,
        remedy="run the mission again with --force",
        error=error,
    )


def no_manifest(*, path: str) -> StorageError:
    """A finished run is wanted, and the folder has no manifest."""
    return StorageError(
        VERIFY_NO_MANIFEST,
        "there is no manifest: no run has finished here",
        where=path,
        remedy="run the mission",
    )


def no_folder_of_results(*, path: str) -> StorageError:
    """A finished run is wanted, and the folder has no trace of one."""
    return StorageError(
        VERIFY_NO_MANIFEST,
        "is not the folder of the results of a run: it has none of the files that a run writes",
        where=path,
        remedy=(
            "name the folder of the results: output.path of the mission file, relative to that "
            "file; if the mission was not run yet, run it"
        ),
    )


def file_instead_of_run(*, path: str, folder: str) -> StorageError:
    """A file is given where the folder of a run is wanted; ``folder`` is that folder, if known."""
    remedy = (
        "name the folder of the results: output.path of the mission file, relative to that file"
    )
    if folder:
        remedy = "name the folder of the results: {folder}"
    return StorageError(
        VERIFY_NO_MANIFEST,
        "is a file; the folder of the results of a run is needed",
        where=path,
        remedy=remedy,
        folder=folder,
    )


def results_damaged(*, path: str, damage: Sequence[str]) -> StorageError:
    """Results are missing or changed; ``damage`` has a line for each."""
    return StorageError(
        VERIFY_DAMAGED,
        "results are damaged: {count}\n    {lines}",
        where=path,
        count=len(damage),
        remedy="run the mission again; the results are written again",
        lines="\n    ".join(damage),
    )


# Missions of a command

CAMPAIGN_MISSION = Code(
    "CAMPAIGN-MISSION",
    means="The option --mission names a mission that the campaign does not have.",
    effect="The command is refused; nothing was run.",
    remedy="Give the name that is under mission.name.",
)
RUN_SHARD = Code(
    "RUN-SHARD",
    means="The requested part of the missions does not exist.",
    effect="Nothing is run.",
    remedy="Count from 0: --shard 0/8 to --shard 7/8.",
)
WORKER_LOST = Code(
    "WORKER-LOST",
    means="The process that ran the mission died twice, or its worker no longer answers.",
    effect="The mission is refused; the others are done.",
    remedy=(
        "Run it again alone. The machine may be short of memory: lower output.batch_rows. If a "
        "worker was stopped, let it go on."
    ),
)
RESULTS_ELSEWHERE = Code(
    "RESULTS-ELSEWHERE",
    means=(
        "A mission was run on another machine. Its results are not in the folder on this machine."
    ),
    effect="The mission is refused here. The results are in the folder of the other machine.",
    remedy="Give all machines the same folders under the same paths.",
)


def no_such_mission(*, name: str, known: Sequence[str]) -> ConfigError:
    """No mission of the command has the name that --mission gives."""
    return ConfigError(
        CAMPAIGN_MISSION,
        "no mission is called {name!r}; there is {known}",
        where="--mission",
        remedy="give --mission the name that is under mission.name",
        name=name,
        known=", ".join(known),
    )


def no_such_shard(*, shard: str) -> ConfigError:
    """--shard is not K/N with K below N."""
    return ConfigError(
        RUN_SHARD,
        "{shard} is not a part of the missions",
        where="--shard",
        remedy="give --shard 0/8 to --shard 7/8 for eight parts, counted from 0",
        shard=shard,
    )


def worker_lost(*, path: str, first: str, second: str, replay: str) -> MissionError:
    """A mission ended its process twice, the second time alone; ``replay`` is its command."""
    return MissionError(
        WORKER_LOST,
        "the process that ran this mission died ({first}), and so did a second one ({second})",
        where=path,
        remedy=(
            "repeat it alone: {replay}; if memory is short, lower output.batch_rows or use a "
            "larger machine"
        ),
        first=first,
        second=second,
        replay=replay,
    )


def no_answer(*, path: str, how: str) -> MissionError:
    """The worker of a mission is silent, and the mission is not given to another one again."""
    return MissionError(
        WORKER_LOST,
        "this mission did not end: {how}, and it is not given to another worker again",
        where=path,
        remedy="let the worker go on, or stop it and start another one, then run again",
        how=how,
    )


def results_elsewhere(*, path: str, name: str) -> MissionError:
    """A worker says that a mission is done, and its results are not in this folder here."""
    return MissionError(
        RESULTS_ELSEWHERE,
        "{name} was run on another machine, and the results are not in this folder here",
        where=path,
        remedy="give all machines the same folders under the same paths (a shared file system), "
        "or run it here",
        name=name,
    )


# Dask

SCHEDULER_EXTRA = Code(
    "SCHEDULER-EXTRA",
    means="The library of the scheduler is not installed.",
    effect="Nothing is run.",
    remedy="pip install 'unbend[dask]'.",
)
SCHEDULER_FILE = Code(
    "SCHEDULER-FILE",
    means="The scheduler file does not exist, or is not a scheduler file.",
    effect="Nothing is run.",
    remedy="Give an address, or the file that dask scheduler --scheduler-file wrote.",
)
SCHEDULER_LOST = Code(
    "SCHEDULER-LOST",
    means="The connection to the scheduler ended while missions were run.",
    effect="Missions that had not ended are refused; the others are done.",
    remedy="Start the scheduler, and run again.",
)
SCHEDULER_NONE = Code(
    "SCHEDULER-NONE",
    means="No Dask scheduler answers at the address.",
    effect="Nothing is run.",
    remedy="Start one, and give its address or its file.",
)
SCHEDULER_WORKERS = Code(
    "SCHEDULER-WORKERS",
    means="The scheduler has no workers, or one of them does not answer.",
    effect="Nothing is run.",
    remedy="Start workers: dask worker ADDRESS. Resume or end a worker that was stopped.",
)
WORKER_FILES = Code(
    "WORKER-FILES",
    means="A worker does not see mission files.",
    effect="Nothing is run.",
    remedy="Give all machines the same folders under the same paths.",
)
WORKER_VERSION = Code(
    "WORKER-VERSION",
    means="A worker has another version of the program, of Python or of a library.",
    effect="Nothing is run. A worker that connects later refuses its missions.",
    remedy="Give all machines one environment, or one image.",
)


def dask_missing(*, error: str) -> ConfigError:
    """--scheduler is given, and distributed cannot be imported."""
    return ConfigError(
        SCHEDULER_EXTRA,
        "the library of the scheduler is not installed: {error}",
        where="--scheduler",
        remedy="pip install 'unbend[dask]'",
        error=error,
    )


def scheduler_file_invalid(*, path: str, error: str) -> ConfigError:
    """--scheduler is neither an address nor the file of a scheduler."""
    return ConfigError(
        SCHEDULER_FILE,
        "this is neither an address of a scheduler nor the file of one: {error}",
        where=path,
        remedy="give tcp://host:port, or the file that dask scheduler --scheduler-file wrote",
        error=error,
    )


def scheduler_lost(*, address: str, error: str) -> MissionError:
    """The scheduler went away while missions ran."""
    return MissionError(
        SCHEDULER_LOST,
        "the connection to the scheduler ended: {error}",
        where=address,
        remedy="start it, then run again: finished missions are kept",
        error=error,
    )


def no_scheduler(*, address: str, error: str) -> ConfigError:
    """Nobody answers at the address of a scheduler."""
    return ConfigError(
        SCHEDULER_NONE,
        "no Dask scheduler answers there: {error}",
        where=address,
        remedy="start one (dask scheduler), and give its address, as tcp://host:8786, or its file",
        error=error,
    )


def no_workers(*, address: str) -> ConfigError:
    """The scheduler is there, and no worker is."""
    return ConfigError(
        SCHEDULER_WORKERS,
        "the scheduler has no workers",
        where=address,
        remedy="start workers: dask worker ADDRESS --nthreads 1",
    )


def worker_silent(*, worker: str, seconds: float) -> ConfigError:
    """A worker is registered, and answers nothing: stopped, swapping, or cut off."""
    return ConfigError(
        SCHEDULER_WORKERS,
        "this worker has not answered for {seconds:.0f} s",
        where=worker,
        remedy="resume it or end it, then run again",
        seconds=seconds,
    )


def files_not_seen(*, worker: str, first: str, count: int) -> ConfigError:
    """A worker looks for mission files that are not in its folders."""
    return ConfigError(
        WORKER_FILES,
        "this worker does not find {count} mission files; the first is {first}",
        one="this worker does not find 1 mission file: {first}",
        where=worker,
        count=count,
        remedy="give all machines the same folders under the same paths (a shared file system)",
        first=first,
    )


def other_versions(*, worker: str, other: Sequence[str]) -> ConfigError:
    """A worker would compute with other versions."""
    return ConfigError(
        WORKER_VERSION,
        "a worker has other versions, and would give different numbers: {other}",
        where=worker,
        remedy="give all machines one environment, or one image",
        other=", ".join(other),
    )


def worker_unable(*, worker: str, error: str) -> ConfigError:
    """A worker cannot even import the program."""
    return ConfigError(
        WORKER_VERSION,
        "a worker cannot run missions: {error}",
        where=worker,
        remedy="install the same version of unbend there: one environment, or one image",
        error=error,
    )


# Object storage

CLOUD_BUCKET = Code(
    "CLOUD-BUCKET",
    means="The bucket or container of a URL does not exist, or is in another region.",
    effect="Nothing is read or written.",
    remedy="Make it, or correct the URL, AWS_REGION or AZURE_STORAGE_ACCOUNT_NAME.",
)
CLOUD_CLOCK = Code(
    "CLOUD-CLOCK",
    means=(
        "The clocks of this machine and of the store differ by more than 15 minutes. So the store "
        "rejects all signatures."
    ),
    effect="Nothing is computed.",
    remedy="Set the clock.",
)
CLOUD_CREDENTIALS = Code(
    "CLOUD-CREDENTIALS",
    means=(
        "There are no credentials for a URL, or the store does not know them. Credentials are read "
        "from the environment: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or "
        "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY (or AZURE_STORAGE_SAS_KEY), or "
        "the role of the machine."
    ),
    effect="Nothing is computed.",
    remedy="Set them; never write them into a mission file.",
)
CLOUD_DENIED = Code(
    "CLOUD-DENIED",
    means=(
        "The store knows the credentials, but they do not have the permission: read, list, write "
        "or delete."
    ),
    effect="Nothing is computed.",
    remedy="Ask for the permission. Results need all four; inputs need read and list.",
)
CLOUD_EXTRA = Code(
    "CLOUD-EXTRA",
    means=(
        "A URL is given, but the package obstore, which reads and writes object storage, is not "
        "installed."
    ),
    effect="The mission is refused.",
    remedy='pip install "unbend[cloud]", or name files here.',
)
CLOUD_FAILED = Code(
    "CLOUD-FAILED",
    means=(
        "A request to object storage failed after several tries: no network, a wrong endpoint, or "
        "an unknown answer."
    ),
    effect="Results that were published before stay. New results are kept in the user's cache.",
    remedy="Check the network, then run again. Only the missing steps are done.",
)
CLOUD_SILENT = Code(
    "CLOUD-SILENT",
    means=(
        "Object storage has not answered within one minute, or has not accepted a file within five "
        "minutes. The network was cut, a proxy blocks it, or the store does not respond."
    ),
    effect=(
        "The mission is not run or not published (exit code 5). The other missions go on. Results "
        "that were published before stay. New results are kept in the user's cache."
    ),
    remedy=(
        "Check the network and AWS_ENDPOINT_URL, then run again. Only the missing steps are done."
    ),
)
CLOUD_UNCONDITIONAL = Code(
    "CLOUD-UNCONDITIONAL",
    means=(
        "The store has no conditional writes. If two runs publish at the same time, both would "
        "seem to succeed."
    ),
    effect="Nothing is computed.",
    remedy="Use another store, or an output folder.",
)


def url_invalid(*, url: str, why: str) -> ConfigError:
    """A URL names no object; ``url`` is what of it may be repeated."""
    return ConfigError(
        URL_INVALID,
        "this is not a URL of object storage: {why}",
        where=url,
        remedy="write s3://bucket/key or az://container/key, with the credentials in the "
        "environment",
        why=why,
    )


def url_for_command(*, url: str, command: str) -> ConfigError:
    """A URL is given to a command that takes paths."""
    return ConfigError(
        URL_INVALID,
        "{command} takes no URLs: it reads and writes files of this machine",
        where=url,
        remedy="copy the object to a file and name that; in a mission file, inputs and "
        "output.path may be URLs",
        command=command,
    )


def url_for_export(*, url: str) -> ConfigError:
    """The file of an export is a URL."""
    return ConfigError(
        URL_INVALID,
        "only the results of a run go to object storage",
        where=url,
        remedy="export to a file here, and copy that",
    )


def obstore_missing(*, url: str) -> ConfigError:
    """A URL is named, and obstore is not installed."""
    return ConfigError(
        CLOUD_EXTRA,
        "object storage is read and written by obstore, which is not installed",
        where=url,
        remedy="pip install 'unbend[cloud]', or name files here",
    )


def no_bucket(*, url: str, answer: str) -> StorageError:
    """The bucket of a URL is not there."""
    return StorageError(
        CLOUD_BUCKET,
        "the bucket or container is not there, or in another region ({answer})",
        where=url,
        remedy=(
            "create it first, or correct the URL; AWS_REGION states the region, "
            "AZURE_STORAGE_ACCOUNT_NAME the account"
        ),
        answer=answer,
    )


def wrong_clock(*, url: str, answer: str) -> StorageError:
    """The store takes no signature of a clock that is off."""
    return StorageError(
        CLOUD_CLOCK,
        "the clock of this machine differs too much from the clock of the store ({answer})",
        where=url,
        remedy="set the clock of this machine; stores refuse a difference of more than 15 minutes",
        answer=answer,
    )


def wrong_credentials(*, url: str, answer: str) -> StorageError:
    """The store does not know the credentials of the environment."""
    return StorageError(
        CLOUD_CREDENTIALS,
        "the store does not know these credentials ({answer})",
        where=url,
        remedy=(
            "check the environment variables that begin with AWS_ or AZURE_; `unbend help "
            "CLOUD-CREDENTIALS` names them"
        ),
        answer=answer,
    )


def no_credentials(*, url: str, scheme: str) -> StorageError:
    """The environment has no credentials."""
    return StorageError(
        CLOUD_CREDENTIALS,
        "there are no credentials for {scheme}://",
        where=url,
        remedy="set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AZURE_STORAGE_ACCOUNT_NAME "
        "and AZURE_STORAGE_ACCOUNT_KEY, or run where the machine has a role",
        scheme=scheme,
    )


def not_allowed(*, url: str, verb: str, answer: str) -> StorageError:
    """The credentials may not read, list, write or delete there."""
    return StorageError(
        CLOUD_DENIED,
        "these credentials have no permission to {verb} there ({answer})",
        where=url,
        remedy="inputs need the permissions to read and list; results also need write and delete",
        verb=verb,
        answer=answer,
    )


def request_failed(*, url: str, verb: str, answer: str) -> StorageError:
    """The store could not do what it was asked."""
    return StorageError(
        CLOUD_FAILED,
        "the store could not {verb} it; its answer: {answer}",
        where=url,
        remedy="check the network, and AWS_ENDPOINT_URL if it is set, then run again",
        verb=verb,
        answer=answer,
    )


def store_silent(*, url: str, verb: str, host: str, seconds: float) -> StorageError:
    """The store did not answer; ``host`` is empty where it is not known."""
    return StorageError(
        CLOUD_SILENT,
        "{host} has not answered within {seconds:.0f} s: request to {verb} it",
        where=url,
        remedy="check the network, and AWS_ENDPOINT_URL if it is set, then run again",
        host=host or "the store",
        seconds=seconds,
        verb=verb,
    )


def writes_unconditional(*, url: str) -> StorageError:
    """The store does not look at the condition of a write."""
    return StorageError(
        CLOUD_UNCONDITIONAL,
        "the store overwrites an object that it was asked to write only if it does not exist",
        where=url,
        remedy=(
            "results need a store with conditional writes (If-None-Match and If-Match); use "
            "another store, or a folder"
        ),
    )


def folder_is_no_block(*, where: object, files: str) -> InputError:
    """`unbend init` is given a folder that no program wrote."""
    return InputError(
        INPUT_MISSING,
        "the folder is not a block: it has none of {files}",
        where=where,
        remedy=(
            "name a log or a block: sparse/0 of COLMAP, the project of OpenSfM, a .psz or .xml of "
            "Metashape, an .xml of DBAT; a folder of images goes with --images"
        ),
        files=files,
    )


def other_images(*, where: object, absent: str, present: str) -> InputError:
    """`unbend init` is given the images of another flight."""
    return InputError(
        IMAGES_OTHER,
        (
            "none of the images of the observations is in the folder: it does not have {absent}, "
            "but it has {present}"
        ),
        where=where,
        remedy="give the images of this flight",
        absent=absent,
        present=present,
    )


ANGLE_CAMERA = Code(
    "ANGLE-CAMERA",
    means="The mission has no camera with the name that `unbend angle --camera` gives.",
    effect="The command is refused.",
    remedy="Give the name of a camera of the mission file.",
)


def no_such_camera(*, where: str, name: str, names: str) -> ConfigError:
    """`unbend angle` is given a camera that the mission does not have."""
    return ConfigError(
        ANGLE_CAMERA,
        "the mission has no camera {name!r}; it has {names}",
        where=where,
        name=name,
        names=names,
        remedy="give one of these names",
    )
