// After the module of a widget's canvas, whose export is `live` here: until the first frame comes, which without a kernel
// it never does, the picture is shown that was kept.
export default () => {
  const { initialize, render } = live()
  return {
    initialize,
    render (context) {
      const end = render(context)
      const image = context.el.querySelector('img')
      const kept = context.model.get('kept')
      // frames are shown as "blob:"
      if (kept && image?.src.startsWith('data:')) { image.src = kept }
      return end
    }
  }
}
