"""An imgui context of one canvas: its events in, its widgets drawn over the picture. Needs imgui-bundle."""

from __future__ import annotations

import logging
from collections.abc import Callable, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orogen.view.controls import Event
from orogen.view.fonts import font_with

if TYPE_CHECKING:
    import wgpu

log = logging.getLogger("orogen")

EVENTS = ("pointer_down", "pointer_move", "pointer_up", "double_click", "wheel", "key_down", "key_up", "char")
"""Events of a canvas that a gui takes."""
POINTER = ("pointer_down", "pointer_move", "pointer_up", "double_click", "wheel")
KEYS = ("key_down", "key_up", "char")
SETTLE, MOST_PENDING = 2, 256
"""Frames until what an event changes shows everywhere, since widgets react to the layout of the frame before; and of
events that wait to be taken: imgui may take presses, releases and letters that come together one in a frame."""
FONT_SIZE = 15.0
"""Height of text in logical pixels."""
ROBOTO = "Roboto/Roboto-Regular.ttf"
"""The panel's font: Latin, Greek and Cyrillic letters."""
Box = tuple[float, float, float, float]


def available() -> bool:
    """Whether imgui-bundle is installed; says once how to get it where it is not."""
    global _told
    try:
        import imgui_bundle  # noqa: F401
    except ImportError as error:
        if not _told:
            log.warning("the window has no panel: %s; pip install imgui-bundle brings it", error)
            _told = True
        return False
    return True


_told = False


class Gui:
    """Widgets over a picture; `build` makes them anew in every frame with `imgui_bundle.imgui`.

    Two guis may exist at a time: each makes its context the current one before it uses it.
    """

    def __init__(self, device: wgpu.GPUDevice, format: str, build: Callable[[], None], letters: Set[str]) -> None:
        """`format`: of the textures that are drawn to. `letters`: those that `build` has shown so far."""
        from imgui_bundle import imgui, implot

        self._imgui, self._implot = imgui, implot
        self._build = build
        self._letters = letters
        self._keys = _key_map()
        self._boxes: list[Box] = []
        self._held = False
        self._pending = SETTLE
        self._whole = True  # whether the latest frame was not broken off between its widgets
        self._open(device, format)

    def _open(self, device: wgpu.GPUDevice, format: str) -> None:
        """Begin with nothing open, typed or scrolled."""
        import imgui_bundle

        imgui = self._imgui
        self._context = imgui.create_context()
        imgui.set_current_context(self._context)
        self._plots = self._implot.create_context()
        self._use(device, format)
        font, fonts = Path(imgui_bundle.__file__).parent / "assets" / "fonts" / ROBOTO, self._backend.io.fonts
        self._font = fonts.add_font_from_file_ttf(str(font), FONT_SIZE) if font.is_file() else fonts.add_font_default()
        self._known: set[str] = set()
        self._merged: set[tuple[str, int]] = set()
        _style(imgui)

    def _use(self, device: wgpu.GPUDevice, format: str) -> None:
        from wgpu.utils.imgui import ImguiWgpuBackend

        self._device = device
        self._backend = ImguiWgpuBackend(device, format)

    def renew(self, device: wgpu.GPUDevice, format: str) -> None:
        """Draw with another device, and keep what is open, typed and scrolled."""
        if not self._whole:
            self.close()
            self._open(device, format)
            return
        self._imgui.set_current_context(self._context)
        self._use(device, format)
        for texture in self._imgui.get_platform_io().textures:
            part = texture.update_rect
            part.x, part.y, part.w, part.h = 0, 0, texture.width, texture.height
            texture.set_tex_id(0)
            texture.set_status(self._imgui.ImTextureStatus.want_create)
        self._pending = SETTLE

    def _learn(self) -> None:
        """Take fonts of this machine for letters that were met: between two frames, as imgui wants it."""
        for letter in sorted(self._letters - self._known):
            self._known.add(letter)
            found = None if self._font.is_glyph_in_font(ord(letter)) else font_with(letter)
            if found and found not in self._merged:
                self._merged.add(found)
                merged = self._imgui.ImFontConfig()
                merged.merge_mode, merged.font_no = True, found[1]
                self._backend.io.fonts.add_font_from_file_ttf(found[0], FONT_SIZE, merged)

    @property
    def settling(self) -> bool:
        """Whether another frame has to be drawn for the last event to show."""
        return self._pending > 0

    @property
    def typing(self) -> bool:
        """Whether a text field has the keyboard."""
        return bool(self._backend.io.want_text_input)

    def handle(self, event: Event) -> bool:
        """Take an event; says whether it was meant for a widget, and so for nothing below it."""
        self._imgui.set_current_context(self._context)
        io, kind = self._backend.io, event["event_type"]
        waiting = 0 if kind == "pointer_move" else self._pending + 1
        self._pending = min(max(waiting, SETTLE), MOST_PENDING)
        if kind in POINTER:
            io.add_mouse_pos_event(event["x"], event["y"])
        if kind in ("pointer_down", "pointer_up"):
            io.add_mouse_button_event({1: 0, 2: 1, 3: 2}.get(event["button"], 0), kind == "pointer_down")
        elif kind == "wheel":
            io.add_mouse_wheel_event(-event["dx"] / 100, -event["dy"] / 100)
        elif kind == "char":
            io.add_input_characters_utf8(event.get("data") or event.get("char_str") or "")
        elif kind in ("key_down", "key_up"):
            for key in self._keys.get(event["key"].lower(), ()):
                io.add_key_event(key, kind == "key_down")
        if kind in KEYS:
            return self.typing
        # a press on a widget keeps the pointer until the release, wherever that is
        over = self._held if kind in ("pointer_move", "pointer_up") else self.covers(event["x"], event["y"])
        if kind == "pointer_down":
            self._held = over
        elif kind == "pointer_up":
            self._held = False
        return over or (kind == "pointer_move" and not event.get("buttons") and self.covers(event["x"], event["y"]))

    def covers(self, x: float, y: float) -> bool:
        """Whether a widget lies at a logical pixel position, by the latest frame."""
        return any(left <= x < right and top <= y < bottom for left, top, right, bottom in self._boxes)

    def note_window(self) -> None:
        """To be called inside every imgui window and popup: there the gui covers the picture."""
        at, size = self._imgui.get_window_pos(), self._imgui.get_window_size()
        self._new_boxes.append((at.x, at.y, at.x + size.x, at.y + size.y))

    def draw(self, target: wgpu.GPUTextureView, size: tuple[float, float], pixel_ratio: float) -> None:
        """Draw over a texture; `size`: width and height in logical pixels."""
        imgui = self._imgui
        imgui.set_current_context(self._context)
        self._implot.set_current_context(self._plots)
        io = self._backend.io
        io.display_size, io.display_framebuffer_scale = size, (pixel_ratio, pixel_ratio)
        self._pending = max(0, self._pending - 1)
        self._new_boxes: list[Box] = []
        self._whole = False
        self._learn()
        imgui.new_frame()
        try:
            self._build()
            self._whole = True
        finally:
            imgui.render()
        self._boxes = self._new_boxes
        if self._letters - self._known:
            self._pending = SETTLE
        encoder = self._device.create_command_encoder(label="gui")
        attachment = {"view": target, "load_op": "load", "store_op": "store"}
        run = encoder.begin_render_pass(color_attachments=[attachment])
        self._backend.render(imgui.get_draw_data(), run)
        run.end()
        self._device.queue.submit([encoder.finish()])

    def close(self) -> None:
        """Give everything back."""
        self._imgui.set_current_context(self._context)
        self._implot.destroy_context(self._plots)
        # imgui expects whoever made its textures to take them back before the context goes
        for texture in self._imgui.get_platform_io().textures:
            texture.set_tex_id(0)
            texture.set_status(self._imgui.ImTextureStatus.destroyed)
        self._imgui.destroy_context(self._context)


def _key_map() -> dict[str, list[Any]]:
    """imgui's keys by the lower-case names of rendercanvas; a modifier is two of them."""
    from imgui_bundle import imgui
    from wgpu.utils.imgui import ImguiRenderer

    keys = {name.lower(): [key] for name, key in ImguiRenderer.KEY_MAP.items()}
    for name, key in ImguiRenderer.KEY_MAP_MOD.items():
        keys[name.lower()].append(key)
    keys |= {str(digit): [getattr(imgui.Key, f"_{digit}")] for digit in range(10)}
    return keys | {letter: [getattr(imgui.Key, letter)] for letter in "abcdefghijklmnopqrstuvwxyz"}


def _style(imgui: Any) -> None:
    imgui.style_colors_dark()
    style = imgui.get_style()
    style.window_rounding = style.frame_rounding = style.grab_rounding = 4.0
    style.window_border_size = 0.0
    # opaque: light is added as light, so that the least of snow would show through what is dark
    for part in (imgui.Col_.window_bg, imgui.Col_.popup_bg):
        style.set_color_(part, (0.05, 0.06, 0.08, 1.0))
    for part in (imgui.Col_.title_bg, imgui.Col_.title_bg_active):
        style.set_color_(part, (0.10, 0.14, 0.20, 1.0))
    style.set_color_(imgui.Col_.frame_bg, (0.13, 0.16, 0.21, 1.0))
    for part, alpha in ((imgui.Col_.header, 0.55), (imgui.Col_.header_hovered, 0.8), (imgui.Col_.header_active, 1.0)):
        style.set_color_(part, (0.22, 0.30, 0.42, alpha))
    # fields and boxes that are off stand out from the panel, and hints can be read
    style.frame_border_size = 1.0
    style.set_color_(imgui.Col_.border, (0.36, 0.42, 0.52, 1.0))
    style.set_color_(imgui.Col_.text_disabled, (0.64, 0.67, 0.72, 1.0))
    style.item_spacing, style.frame_padding = (8.0, 5.0), (6.0, 3.0)
