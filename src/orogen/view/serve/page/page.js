// Shows the pictures that come, and tells what pointer and keys do.

'use strict'

const canvas = document.getElementById('view')
const notice = document.getElementById('notice')
const text = document.getElementById('text')
const again = document.getElementById('again')
const context = canvas.getContext('2d')
const held = new Set()
let socket = null
let size = null
// whether a connection that breaks is worth another try: tabs that were suspended and networks that slept come back
let hopeful = false

function say (message, retry) {
  text.textContent = message
  again.hidden = !retry
  notice.hidden = false
}

function tell (message) {
  if (socket !== null && socket.readyState === WebSocket.OPEN) {
    socket.send(JSON.stringify(message))
  }
}

class View extends window.BaseRenderView {
  onEvent (event) {
    if (event.type === 'resize') { size = event }
    if (event.type === 'key_down') { held.add(event.key) }
    if (event.type === 'key_up') { held.delete(event.key) }
    if (event.type === 'focus_out') { release() }
    tell(event)
  }

  focus () { this._focusElement.focus({ preventScroll: true }) }
}

// a key that is let go elsewhere would be held for ever
function release () {
  for (const key of held) { tell({ type: 'key_up', key, modifiers: [] }) }
  held.clear()
}

async function show (data) {
  const index = Number(new DataView(data).getBigUint64(0))
  try {
    const picture = await window.createImageBitmap(new Blob([new Uint8Array(data, 8)], { type: 'image/jpeg' }))
    if (canvas.width !== picture.width || canvas.height !== picture.height) {
      canvas.width = picture.width
      canvas.height = picture.height
    }
    context.drawImage(picture, 0, 0)
    picture.close()
    notice.hidden = true
    hopeful = true
    document.documentElement.dataset.shown = index
  } finally {
    tell({ type: 'shown', index })
  }
}

function connect () {
  say('Connecting …', false)
  const address = new URL('socket', window.location.href)
  address.protocol = address.protocol.replace('http', 'ws')
  socket = new WebSocket(address)
  socket.binaryType = 'arraybuffer'
  // one after the other, so that an older picture never replaces a newer one
  let last = Promise.resolve()
  socket.onopen = () => {
    say('Loading the terrain …', false)
    if (size !== null) { tell(size) }
  }
  socket.onmessage = (event) => { last = last.then(() => show(event.data)).catch(() => {}) }
  socket.onclose = (event) => {
    held.clear()
    if (event.code === 1006 && hopeful) {
      hopeful = false
      setTimeout(connect, 500)
      return
    }
    const reason = event.reason || (event.code === 1006 ? 'the server does not answer' : 'the server has ended')
    say(reason.charAt(0).toUpperCase() + reason.slice(1) + '.', true)
  }
}

const view = new View(canvas, null)
canvas.style.width = '100vw'
canvas.style.height = '100vh'
// Tab changes the controls; it must not leave the picture
view._focusElement.addEventListener('keydown', (event) => { if (event.key === 'Tab') { event.preventDefault() } })
// the wheel works before the first click
canvas.addEventListener('pointerenter', () => view.focus())
window.addEventListener('blur', release)
again.addEventListener('click', connect)
view.focus()
connect()
