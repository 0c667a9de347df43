"""The words of pages and documents in the reader's language: gettext catalogues in `locale`, English where one has no
word. `catalogue` looks words up, `said` keeps a sentence with its values until it is known in what language it is read,
`sentences` are those that arrive ready made. Knows nothing of what the words mean.

Numbers are the same in all languages: a decimal point, no mark between thousands, SI units, dates as in ISO 8601. So
what is copied from a page is what the record holds.
"""

from highside.words.catalogue import LANGUAGES, _, from_to, in_language, language, several, told
from highside.words.marks import said_later
from highside.words.said import Said, said

__all__ = ["LANGUAGES", "Said", "_", "from_to", "in_language", "language", "said", "said_later", "several", "told"]
