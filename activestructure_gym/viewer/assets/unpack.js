"use strict";
// Unpack a film: deflated bytes of a JSON header and arrays (layout: packing.py), in base64 if from a script element.
function unpackText(text) {
  const letters = atob(text.trim());
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
  return unpack(packed);
}

async function unpack(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const whole = await new Response(stream).arrayBuffer();
  const length = new DataView(whole).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(whole, 4, length)));
  const kinds = { u1: Uint8Array, i1: Int8Array, u2: Uint16Array, i4: Int32Array, f4: Float32Array };
  const arrays = {};
  for (const [name, place] of Object.entries(header.arrays)) {
    const size = place.shape.reduce((a, b) => a * b, 1);
    arrays[name] = new kinds[place.type](whole, 4 + length + place.at, size);
  }
  return { ...header, arrays };
}
