// What the file holds: numbers and names as JSON, the model as base 64 of zlib.

const byId = (id) => document.getElementById(id);

/** Bytes of an element's base 64, unpacked. */
async function unpack(id) {
  const text = byId(id).textContent.trim();
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
