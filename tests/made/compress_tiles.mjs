// Compresses the buffers of tiles with EXT_meshopt_compression, in place: node compress_tiles.mjs PAGE FOLDER
// Triangles and vertices are put into an order that compresses well first, as other tools do.
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [, , page, folder] = process.argv;
const { MeshoptEncoder } = await import(pathToFileURL(join(page, "node_modules/meshoptimizer/meshopt_encoder.js")));
await MeshoptEncoder.ready;

function compressed(file) {
  const size = file.readUInt32LE(12);
  const tree = JSON.parse(file.subarray(20, 20 + size).toString());
  const binary = file.subarray(28 + size);
  const { attributes, indices } = tree.meshes[0].primitives[0];
  const { componentType, count } = tree.accessors[indices];
  const at = tree.bufferViews[tree.accessors[indices].bufferView];
  const bytes = componentType === 5123 ? 2 : 4;
  const found = Uint32Array.from({ length: count }, (_, i) => binary.readUIntLE(at.byteOffset + i * bytes, bytes));
  const [remap, used] = MeshoptEncoder.reorderMesh(found, true, true);
  const pieces = [];
  let offset = 0;
  let plain = 0;
  function put(number, data, stride, rows, mode) {
    const packed = Buffer.from(MeshoptEncoder.encodeGltfBuffer(data, rows, stride, mode, 0));
    const old = tree.bufferViews[tree.accessors[number].bufferView];
    const extension = { buffer: 0, byteOffset: offset, byteLength: packed.length, byteStride: stride, count: rows, mode };
    const view = { ...old, buffer: 1, byteOffset: plain, byteLength: rows * stride };
    tree.bufferViews[tree.accessors[number].bufferView] = { ...view, extensions: { EXT_meshopt_compression: extension } };
    pieces.push(packed, Buffer.alloc(-packed.length & 3));
    offset += packed.length + (-packed.length & 3);
    plain += rows * stride + (-(rows * stride) & 3);
  }
  for (const number of Object.values(attributes)) {
    const { byteOffset, byteStride } = tree.bufferViews[tree.accessors[number].bufferView];
    const data = new Uint8Array(used * byteStride);
    remap.forEach((to, from) => {
      if (to < used) data.set(binary.subarray(byteOffset + from * byteStride, byteOffset + (from + 1) * byteStride), to * byteStride);
    });
    put(number, data, byteStride, used, "ATTRIBUTES");
  }
  const narrowed = bytes === 2 ? Uint16Array.from(found) : found;
  put(indices, new Uint8Array(narrowed.buffer), bytes, count, "TRIANGLES");
  tree.buffers = [
    { byteLength: offset },
    { byteLength: plain, extensions: { EXT_meshopt_compression: { fallback: true } } },
  ];
  for (const name of ["extensionsUsed", "extensionsRequired"]) {
    tree[name] = [...(tree[name] ?? []), "EXT_meshopt_compression"];
  }
  const text = Buffer.from(JSON.stringify(tree));
  const padded = Buffer.concat([text, Buffer.alloc(-text.length & 3, " ")]);
  const head = Buffer.alloc(20);
  [0x46546c67, 2, 28 + padded.length + offset, padded.length, 0x4e4f534a].forEach((word, i) => head.writeUInt32LE(word, 4 * i));
  const chunk = Buffer.alloc(8);
  [offset, 0x004e4942].forEach((word, i) => chunk.writeUInt32LE(word, 4 * i));
  return Buffer.concat([head, padded, chunk, ...pieces]);
}

for (const name of readdirSync(folder)) writeFileSync(join(folder, name), compressed(readFileSync(join(folder, name))));
