"""URLs of stores: which may be read, and that none holds a password, since configurations are written into results."""

import re

from omniocc.errors import UserError

AWS = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or ~/.aws"
AZURE = "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY"
GOOGLE = "GOOGLE_APPLICATION_CREDENTIALS"
NETRC = "~/.netrc, or the file that NETRC names"
CREDENTIALS = {
    "http": NETRC,
    "https": NETRC,
    "s3": AWS,
    "s3a": AWS,
    "gs": GOOGLE,
    "gcs": GOOGLE,
    "abfs": AZURE,
    "az": AZURE,
    "file": "",
    "memory": "",
}
"""The protocols that are read, and where the clients of their stores look for credentials."""
ANY = "the environment variables FSSPEC_<PROTOCOL>_<OPTION> or ~/.config/fsspec"
WITH_CONTAINER = ("abfs", "az")
"""Protocols whose URLs may name a container before the host: `abfs://container@account.dfs.core.windows.net`."""

# a password may hold the characters that end a host; what follows a colon is a port if it is a number
_USER = re.compile(r"(\w*)://(?!\[)([^/?#\n]*|[^/?#:\n]*:(?!\d{1,5}(?:[/?#,\]]|$)).*)@")
_QUERY = re.compile(r"(://\S*?\?)\S+|(://\S*?[#;])\S*=\S+")


def redacted(text: str) -> str:
    """Return a text with `***` for user and password, query and assignments behind `#` or `;` of every URL in it."""

    def without_user(found: re.Match[str]) -> str:
        is_container = found[1] in WITH_CONTAINER and ":" not in found[2]
        return found[0] if is_container else f"{found[1]}://***@"

    return _QUERY.sub(lambda found: f"{found[1] or found[2]}***", _USER.sub(without_user, text))


def credentials_problem(text: str) -> str | None:
    """Return what is wrong with a text that holds a URL with credentials, without them; None for any other text."""
    hidden = redacted(text)
    if hidden == text:
        return None
    before = hidden.partition("://")[0]
    ways = CREDENTIALS.get(re.split(r"\W", before)[-1]) or ANY
    return (
        f"{hidden}: a URL with a user, password or query (***) would be written into results, tables and checkpoints; "
        f"leave them out and give credentials by {ways}"
    )


def check_url(url: str) -> None:
    """Check that a URL is of a protocol in `CREDENTIALS`, of that alone, and without credentials.

    Raises:
        UserError: naming the URL, without credentials, and what to give instead.
    """
    if problem := credentials_problem(url):
        raise UserError(problem)
    protocol = url.partition("://")[0]
    if "::" in url:
        raise UserError(
            f"{url}: URLs with '::' (chains of fsspec, IPv6 addresses) are not read; name the folder itself"
        )
    if protocol not in CREDENTIALS:
        raise UserError(
            f"{url}: {protocol}:// is not read; known are {', '.join(f'{known}://' for known in CREDENTIALS)}"
        )
