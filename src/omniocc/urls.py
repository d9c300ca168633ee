"""Checks of the URLs of stores: the protocol is known and the URL holds no password.

Configurations, with their URLs, are written into results, so a password in a URL would be published.
"""

import re

from omniocc.errors import UserError

AWS_CREDENTIALS = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or ~/.aws"
AZURE_CREDENTIALS = "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY"
GOOGLE_CREDENTIALS = "GOOGLE_APPLICATION_CREDENTIALS"
NETRC_CREDENTIALS = "~/.netrc, or the file that NETRC names"
CREDENTIALS = {
    "http": NETRC_CREDENTIALS,
    "https": NETRC_CREDENTIALS,
    "s3": AWS_CREDENTIALS,
    "s3a": AWS_CREDENTIALS,
    "gs": GOOGLE_CREDENTIALS,
    "gcs": GOOGLE_CREDENTIALS,
    "abfs": AZURE_CREDENTIALS,
    "az": AZURE_CREDENTIALS,
    "file": "",
    "memory": "",
}
"""Protocols that can be read, each with the places where its client looks for credentials; "": it needs none."""
OTHER_CREDENTIALS = "the environment variables FSSPEC_<PROTOCOL>_<OPTION> or ~/.config/fsspec"
CONTAINER_PROTOCOLS = ("abfs", "az")
"""Protocols whose URLs may name a container before the host: `abfs://container@account.dfs.core.windows.net`."""

# Group 1 is the protocol, group 2 the text before '@'. The first alternative is a user without '/', '?' or '#'. The
# second is 'user:password': a password may hold these characters too, but digits after the colon are a port.
_USER = re.compile(r"(\w*)://(?!\[)([^/?#\n]*|[^/?#:\n]*:(?!\d{1,5}(?:[/?#,\]]|$)).*)@")
# the query behind '?', or an assignment behind '#' or ';'
_QUERY = re.compile(r"(://\S*?\?)\S+|(://\S*?[#;])\S*=\S+")


def redact(text: str) -> str:
    """Return a text in which `***` replaces the secret parts of every URL.

    These are the user with the password, the query, and assignments (`key=value`) behind `#` or `;`.
    """

    def hide_user(match: re.Match[str]) -> str:
        is_container = match[1] in CONTAINER_PROTOCOLS and ":" not in match[2]
        return match[0] if is_container else f"{match[1]}://***@"

    return _QUERY.sub(lambda match: f"{match[1] or match[2]}***", _USER.sub(hide_user, text))


def credentials_problem(text: str) -> str | None:
    """Return an error message, with `***` for the credentials, if a text holds a URL with credentials; else None."""
    redacted = redact(text)
    if redacted == text:
        return None
    before = redacted.partition("://")[0]  # may hold more than the protocol, such as 'simplecache::http'
    places = CREDENTIALS.get(re.split(r"\W", before)[-1]) or OTHER_CREDENTIALS
    return (
        f"{redacted}: a URL with a user, password or query (***) would be written into results, tables and "
        f"checkpoints; leave them out and give credentials by {places}"
    )


def check_url(url: str) -> None:
    """Check that a URL has one protocol, that it is in `CREDENTIALS`, and that the URL holds no credentials.

    Raises:
        UserError: if a check fails; the message names the URL without credentials.
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
