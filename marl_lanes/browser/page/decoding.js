// Reads what browser/encoding.py writes: chunks of rows, back into typed arrays.

const ARRAYS = {
  i1: Int8Array,
  i2: Int16Array,
  i4: Int32Array,
  f4: Float32Array,
  f8: Float64Array,
};

/** Refuses a header of another form. */
export function checkHeader(header) {
  if (header.format !== 2) {
    throw new Error(`format = ${header.format}: must be 2; make the page again with this version`);
  }
}

/** The columns of a chunk, by name: one typed array each. */
export async function decodeChunk(header, chunk) {
  const bytes = await inflate(chunk.data);
  const count = chunk.num_rows;
  const columns = {};
  let offset = 0;
  header.columns.forEach((column, index) => {
    const width = chunk.widths[index];
    columns[column.name] = decodeColumn(bytes, offset, width, count, column);
    offset += width * count;
  });
  if (offset !== bytes.length) {
    throw new Error(`chunk of ${bytes.length} bytes: must have ${offset}`);
  }
  return columns;
}

async function inflate(text) {
  const binary = atob(text);
  const packed = new Uint8Array(binary.length);
  for (let i = 0; i < packed.length; i += 1) packed[i] = binary.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function decodeColumn(bytes, offset, width, count, column) {
  const values = new ARRAYS[column.type](count);
  const { quantum, is_optional: isOptional } = column;
  const second = offset + count;
  const third = second + count;
  const fourth = third + count;
  let code = 0;
  for (let i = 0; i < count; i += 1) {
    let zigzag = bytes[offset + i];
    if (width > 1) zigzag |= bytes[second + i] << 8;
    if (width > 2) zigzag |= (bytes[third + i] << 16) | (bytes[fourth + i] << 24);
    code += (zigzag >>> 1) ^ -(zigzag & 1);
    if (quantum === null) values[i] = code;
    else if (!isOptional) values[i] = code * quantum;
    else if (code === 0) values[i] = NaN;
    else values[i] = (code > 0 ? code - 1 : code) * quantum;
  }
  return values;
}
