"""Translation of store errors into one sentence that can never quote a credential.

The raw texts carry request URLs, headers and XML bodies, so nothing of them is passed on. They are
only searched for the few words that identify a cause.
"""

import re
from typing import Final

from obstore.exceptions import (
    InvalidPathError,
    NotFoundError,
    NotSupportedError,
    PermissionDeniedError,
    PreconditionError,
    UnauthenticatedError,
    UnknownConfigurationKeyError,
)

from schemas.errors import (
    BucketRefusedError,
    BucketUnreachableError,
    CounterpointError,
    ObjectChangedError,
)
from schemas.visible import visible

SUPPORTED_URLS: Final = (
    "use file:///folder, a path, s3://bucket/prefix, gs://bucket/prefix or az://container/prefix"
)
_VARIABLES: Final = {
    "s3": "AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS",
    "az": "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
}
"""Environment variables of credentials, as each store's own tools read them."""

_EXPIRED: Final = frozenset({"ExpiredToken", "TokenRefreshRequired", "InvalidToken"})
# What object_store asks for credentials when it was given none.
_CREDENTIAL_SERVICES: Final = (
    "169.254.169.254",
    "169.254.170.2",
    "metadata.google.internal",
    "metadata/identity",
    "MissingCredentials",
    "application_default_credentials",
    "Account must be specified",
)
_CONNECTION_PROBLEMS: Final = (
    ("dns error", "its name cannot be resolved"),
    ("failed to lookup", "its name cannot be resolved"),
    ("Connection refused", "connection refused"),
    ("certificate", "its certificate is not trusted"),
    ("TimedOut", "no answer in time"),
    ("timed out", "no answer in time"),
    ("Timeout", "no answer in time"),
)
_MOVED_ON: Final = ("412", "416")
"""Status codes of a changed object: its etag differs, or it ends before the range begins."""
_STATUS: Final = re.compile(r"\bstatus: (\d{3})\b|non-2xx status code: (\d{3})\b")
_UNUSABLE_KEY: Final = re.compile(r'object with invalid path: [^"]*"(.{1,1100}?)"[ :]', re.DOTALL)
_CODE: Final = re.compile(r"<Code>([A-Za-z]{1,60})</Code>")


def explain(
    error: Exception, *, url: str, key: str = "", writing: bool = False
) -> CounterpointError:
    """Translate an error of the store into one of ours.

    Args:
        error: Error raised by obstore.
        url: The bucket, without credentials.
        key: The object it was about; empty for the bucket as a whole.
        writing: True if the operation was a write.
    """
    where = f"({url}, {key})" if key else f"({url})"
    text = str(error)
    code = _CODE.search(text)
    said = code.group(1) if code else ""
    if said == "NoSuchBucket" or "canonicalize filesystem root" in text:
        return BucketRefusedError(f"there is no such bucket or folder {where}")
    if any(service in text for service in _CREDENTIAL_SERVICES):
        return BucketRefusedError(f"no credentials for the bucket: {_set_them(url)} {where}")
    status = _status(text)
    if (
        isinstance(error, PermissionDeniedError | UnauthenticatedError)
        or status in ("401", "403")
        or said in _EXPIRED
    ):
        doing = "writing" if writing else "reading" if key else "listing"
        return BucketRefusedError(f"{_denial(said, url=url, doing=doing)} {where}")
    if isinstance(error, PermissionError) or "PermissionDenied" in text:
        return BucketRefusedError(f"no permission to {'write' if writing else 'read'} {where}")
    # What breaks off in mid-read is asked for again, and comes as no more than "some error".
    if isinstance(error, FileNotFoundError | NotFoundError) or said == "NoSuchKey":
        if key and not writing:
            return ObjectChangedError(key=key)
        return BucketRefusedError(f"there is no such bucket or folder {where}")
    if isinstance(error, PreconditionError) or "StartTooLarge" in text or status in _MOVED_ON:
        return ObjectChangedError(key=key)
    if "BareRedirect" in text:
        return BucketRefusedError(
            f"the store sends the request elsewhere: check bucket, region and endpoint {where}"
        )
    listed = _UNUSABLE_KEY.search(text)
    if isinstance(error, InvalidPathError) and listed is not None and not key:
        return BucketRefusedError(
            f"the store lists a key that cannot be used, '{visible(listed.group(1), limit=1024)}'"
            f": rename or delete that object, or name a folder without it {where}"
        )
    if isinstance(error, UnknownConfigurationKeyError | NotSupportedError | InvalidPathError):
        return BucketRefusedError(f"the store cannot be used like this: {SUPPORTED_URLS} {where}")
    return _by_status(status, text, said=said, where=where)


def _by_status(status: str, text: str, *, said: str, where: str) -> CounterpointError:
    if status.startswith(("3", "4")) and status not in ("408", "429"):
        return BucketRefusedError(
            f"the store refuses the request with status {status}{f' ({said})' if said else ''}; "
            f"check bucket, region, endpoint and credentials {where}"
        )
    if status:
        return BucketUnreachableError(
            f"the store answers with error {status}; try again later {where}"
        )
    for sign, problem in _CONNECTION_PROBLEMS:
        if sign in text:
            return BucketUnreachableError(f"the store cannot be reached: {problem} {where}")
    if "HttpError" in text or "error sending request" in text:
        return BucketUnreachableError(f"the store cannot be reached {where}")
    if "Io" in text or "LocalFileSystem" in text:
        return BucketUnreachableError(f"the file system answers with an error {where}")
    return BucketRefusedError(f"the store cannot be used: {SUPPORTED_URLS} {where}")


def _denial(code: str, *, url: str, doing: str) -> str:
    """Describe a problem with credentials and its remedy; `code` is the store's own error code."""
    named = f" ({code})" if code else ""
    if code == "AccessDenied":
        return f"the store denies these credentials {doing} here{named}: grant it, or use others"
    if code == "RequestTimeTooSkewed":
        return f"the store refuses requests of a wrong clock{named}: set this machine's clock"
    if code in _EXPIRED:
        return f"these credentials have expired{named}: {_set_them(url)}"
    if code == "InvalidAccessKeyId":
        return f"the store does not know these credentials{named}: {_set_them(url)}"
    return f"the store refuses these credentials{named}: {_set_them(url)}"


def _set_them(url: str) -> str:
    scheme = url.partition("://")[0]
    return f"set {_VARIABLES[scheme]}" if scheme in _VARIABLES else "set them in the environment"


def _status(text: str) -> str:
    found = _STATUS.search(text)
    return (found.group(1) or found.group(2)) if found else ""
