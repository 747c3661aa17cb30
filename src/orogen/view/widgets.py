"""Fields of a panel: each with its label, its help, and under it what was wrong with the last input."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from typing import Any

from orogen.errors import OrogenError, SettingsError

PROBLEM = (1.0, 0.55, 0.45, 1.0)
"""Colour of messages (red, green, blue, alpha)."""
QUIET = (0.66, 0.69, 0.74, 1.0)
"""Colour of remarks."""
WIDTH = 0.56
"""Part of the panel's width that fields take; their labels have the rest."""

LONGEST = 300
"""Letters of a message, at most."""
MOST_LETTERS = 5000
"""Different letters for which fonts are looked for: someone may type all there are."""

Action = Callable[[Any], None]


class Widgets:
    """Makes fields with imgui and carries out what users enter; an error stays beside its field until the next try."""

    def __init__(self) -> None:
        from imgui_bundle import imgui

        self.imgui = imgui
        self.places: dict[str, tuple[float, float]] = {}
        """Middle of every field, where it was drawn last, in logical pixels."""
        self.problems: dict[str, str] = {}
        """What was wrong with the last input, by field."""
        self.letters: set[str] = set()
        """Letters beyond ASCII that were shown; fonts are looked for that have them."""
        self._edited: dict[str, str] = {}
        self._typed = ""  # the slider that is a text field now

    def see(self, *texts: str) -> None:
        """Note which letters texts have."""
        for text in texts:
            if not text.isascii() and len(self.letters) < MOST_LETTERS:
                self.letters.update(letter for letter in text if letter > "\x7f" and letter.isprintable())

    def attempt(self, name: str, action: Callable[[], None]) -> bool:
        """Carry out what a field asks for; says whether it worked. A failure is told beside the field."""
        try:
            action()
        except OrogenError as error:
            self.problems[name] = str(error)
            return False
        self.problems.pop(name, None)
        self._edited.pop(name, None)
        return True

    def text(self, name: str, value: str, action: Action, help: str = "", hint: str = "", wide: bool = False) -> None:
        """A line of text, which is taken with Enter or when the field is left."""
        imgui = self.imgui
        self._width(wide)
        shown = self._edited.get(name, value)
        label = f"##{name}" if wide else name
        _, entered = imgui.input_text_with_hint(label, hint, shown)
        self.see(entered)
        if imgui.is_item_active() or entered != shown:
            self._edited[name] = entered
        if imgui.is_item_deactivated_after_edit():
            text = self._edited.get(name, entered)
            self.attempt(name, lambda: action(text))
        elif imgui.is_item_deactivated() and name not in self.problems:
            self._edited.pop(name, None)
        self._after(name, help)

    def slider(
        self,
        name: str,
        value: float,
        limits: tuple[float, float],
        action: Action,
        help: str = "",
        *,
        format: str = "%.3g",
        logarithmic: bool = False,
        late: bool = False,
    ) -> None:
        """A number within limits; `late`: taken when the slider is let go. A double click or Ctrl-click types one."""
        imgui = self.imgui
        self._width()
        if self._wants_text():
            self._typed, self._edited[name] = name, format % value
            imgui.set_keyboard_focus_here()
        if self._typed == name:
            self._type(name, action)
            self._after(name, help)
            return
        flags = imgui.SliderFlags_.no_input | (imgui.SliderFlags_.logarithmic if logarithmic else 0)
        shown = float(self._edited.get(name, value))
        moved, number = imgui.slider_float(name, shown, limits[0], limits[1], format, flags)
        if moved:
            if late:
                self._edited[name] = str(number)
            else:
                self.attempt(name, lambda: action(number))
        if late and imgui.is_item_deactivated_after_edit():
            self.attempt(name, lambda: action(number))
            self._edited.pop(name, None)
        self._after(name, help)

    def _wants_text(self) -> bool:
        """Whether the press of a pointer asks that the slider that comes next be typed into."""
        imgui = self.imgui
        asked = imgui.is_mouse_double_clicked(0) or (imgui.is_mouse_clicked(0) and imgui.get_io().key_ctrl)
        at = imgui.get_cursor_screen_pos()
        end = at.x + imgui.calc_item_width(), at.y + imgui.get_frame_height()
        return bool(asked and imgui.is_window_hovered() and imgui.is_mouse_hovering_rect((at.x, at.y), end))

    def _type(self, name: str, action: Action) -> None:
        """The text field in place of a slider; it is one again when the text is taken, refused or left."""
        imgui = self.imgui
        flags = imgui.InputTextFlags_.auto_select_all
        before = self._edited.get(name, "")
        imgui.push_id("typed")  # else imgui takes it for the slider
        _, self._edited[name] = imgui.input_text(name, before, flags)
        imgui.pop_id()
        if imgui.is_item_deactivated():
            text, self._typed = self._edited.pop(name), ""
            if imgui.is_item_deactivated_after_edit():
                self.attempt(name, lambda: action(number_of(text)))

    def switch(self, name: str, value: bool, action: Action, help: str = "") -> None:
        """Something that is on or off."""
        changed, on = self.imgui.checkbox(name, value)
        if changed:
            self.attempt(name, lambda: action(on))
        self._after(name, help)

    def choice(self, name: str, value: str, choices: Sequence[str], action: Action, help: str = "") -> None:
        """One of several words."""
        self._width()
        current = choices.index(value) if value in choices else 0
        changed, number = self.imgui.combo(name, current, list(choices))
        if changed:
            self.attempt(name, lambda: action(choices[number]))
        self._after(name, help)

    def button(self, name: str, action: Callable[[], None], help: str = "", *, beside: bool = False) -> None:
        """Something to do. `beside`: on the line of what came before."""
        self.see(name)
        if beside:
            self.imgui.same_line()
        if self.imgui.button(name):
            self.attempt(name, action)
        self._after(name, help)

    def remark(self, text: str) -> None:
        """A line that only tells."""
        self.see(text)
        imgui = self.imgui
        imgui.push_style_color(imgui.Col_.text, QUIET)
        imgui.text_wrapped(text)
        imgui.pop_style_color()

    def problem(self, text: str) -> None:
        """A message on what went wrong."""
        self.see(text)
        imgui = self.imgui
        imgui.push_style_color(imgui.Col_.text, PROBLEM)
        imgui.text_wrapped(shortened(text))
        imgui.pop_style_color()

    def section(self, name: str, open: bool = False) -> bool:
        """A heading that opens and closes; says whether it is open."""
        imgui = self.imgui
        shown = imgui.collapsing_header(name, imgui.TreeNodeFlags_.default_open if open else 0)
        self._note(name)
        return bool(shown)

    def _width(self, wide: bool = False) -> None:
        room = self.imgui.get_content_region_avail().x
        self.imgui.set_next_item_width(room if wide else math.floor(WIDTH * room))

    def _after(self, name: str, help: str) -> None:
        imgui = self.imgui
        self._note(name)
        if help and not imgui.is_item_active() and self._hovered() and imgui.begin_tooltip():
            imgui.push_text_wrap_pos(340.0)
            imgui.text_unformatted(help)
            imgui.pop_text_wrap_pos()
            imgui.end_tooltip()
        if name in self.problems:
            self.problem(self.problems[name])

    def _hovered(self) -> bool:
        flags = self.imgui.HoveredFlags_.delay_normal | self.imgui.HoveredFlags_.no_shared_delay
        return bool(self.imgui.is_item_hovered(flags))

    def _note(self, name: str) -> None:
        low, size = self.imgui.get_item_rect_min(), self.imgui.get_item_rect_size()
        # a field's label is part of it: the middle would fall beside the field
        self.places[name] = (low.x + min(size.x / 4, 40.0), low.y + size.y / 2)


def shortened(text: str) -> str:
    """A message of at most `LONGEST` letters: its beginning and its end, where what was typed was long."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"


def quoted(text: str) -> str:
    """What a user typed, as messages tell it."""
    return repr(text) if text.strip() else "nothing"


def path_of(text: str, example: str) -> str:
    """A file's name that a user typed, ~ resolved; SettingsError where there is none."""
    if not text.strip():
        raise SettingsError(f"expected a name such as {example}, got nothing")
    return os.path.expanduser(text.strip())


def two_numbers(text: str, example: str = "301500, 2654000") -> tuple[float, float]:
    """Two numbers that a user typed; SettingsError where they are none."""
    parts = text.replace(",", " ").split()
    if len(parts) != 2:
        raise SettingsError(f"expected two numbers such as {example}, got {quoted(text)}")
    return number_of(parts[0]), number_of(parts[1])


def size_of(text: str, most: int) -> tuple[int, int]:
    """Width and height that a user typed, such as 1920 x 1080; SettingsError where they are none, or above `most`."""
    width, height = (round(v) for v in two_numbers(text.lower().replace("x", " "), "1920 x 1080"))
    if not (1 <= width <= most and 1 <= height <= most):
        raise SettingsError(f"size: expected 1 to {most} pixels on each side, got {width}x{height}")
    return width, height


def number_of(text: str) -> float:
    """A finite number that a user typed; SettingsError where it is none."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not math.isfinite(value):
        raise SettingsError(f"expected a number, got {quoted(text)}")
    return value
