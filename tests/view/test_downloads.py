from rendercanvas.offscreen import OffscreenRenderCanvas

from orogen.gpu import open_gpu
from orogen.view.downloads import survive_lost_devices


def test_a_picture_fetched_from_a_device_that_is_gone_is_black(gpu):
    survive_lost_devices()
    canvas = OffscreenRenderCanvas(size=(60, 40))
    context = canvas.get_wgpu_context()
    with open_gpu(str(gpu.info.index)) as own:
        context.configure(device=own.device, format=context.get_preferred_format(own.device.adapter))
        context.get_current_texture()
        downloader, shown = context._downloader, []
        downloader._get_awaitable_for_download(context._texture)
        downloader._awaitable.sync_wait()
        own.device.destroy()
        # here is when the memory goes
        own.device._poll()
        downloader._action.then(shown.append)
        downloader._action.resolve()
    (result,) = shown
    assert result["data"].shape == (40, 60, 4)
    assert not result["data"].any()
