"""Texts of messages that a damaged or hostile file would make as long as itself."""

from unbend.errors import LONGEST_TEXT, LONGEST_WORD, SHOWN_OF_WORD, rendered


def test_a_list_of_thousands_of_names_is_cut():
    names = ", ".join(f"chunk {number}" for number in range(200_000))
    text = rendered("it has {names}", {"names": names})
    assert len(text) < LONGEST_TEXT + 100
    assert text.startswith("it has chunk 0, chunk 1, ")
    left_out = len(f"it has {names}") - LONGEST_TEXT
    assert text.endswith(f"... ({left_out:,} more characters)")


def test_a_text_of_the_longest_length_is_whole():
    text = "ab " * (LONGEST_TEXT // 3)
    assert rendered("{text}", {"text": text}) == text


def test_a_very_long_word_has_only_its_beginning():
    word = "x" * LONGEST_WORD
    assert rendered("{word} there", {"word": word}) == f"{'x' * SHOWN_OF_WORD}... there"
    assert rendered("{word}", {"word": word[1:]}) == word[1:]
