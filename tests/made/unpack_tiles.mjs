// Undoes EXT_meshopt_compression in tiles, in place, with meshoptimizer's own decoder: node unpack_tiles.mjs PAGE FOLDER
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [, , page, folder] = process.argv;
const { MeshoptDecoder } = await import(pathToFileURL(join(page, "node_modules/meshoptimizer/meshopt_decoder.mjs")));
await MeshoptDecoder.ready;
const NAME = "EXT_meshopt_compression";

function unpacked(file) {
  const size = file.readUInt32LE(12);
  const tree = JSON.parse(file.subarray(20, 20 + size).toString());
  const binary = file.subarray(28 + size);
  const pieces = [];
  let offset = 0;
  tree.bufferViews = tree.bufferViews.map(({ extensions, ...view }) => {
    let data = binary.subarray(view.byteOffset, view.byteOffset + view.byteLength);
    if (extensions) {
      const { byteOffset, byteLength, byteStride, count, mode } = extensions[NAME];
      data = Buffer.alloc(count * byteStride);
      MeshoptDecoder.decodeGltfBuffer(data, count, byteStride, binary.subarray(byteOffset, byteOffset + byteLength), mode);
    }
    const moved = { ...view, buffer: 0, byteOffset: offset };
    if (data.length !== view.byteLength) throw new Error("a view of another size");
    pieces.push(data, Buffer.alloc(-data.length & 3));
    offset += data.length + (-data.length & 3);
    return moved;
  });
  tree.buffers = [{ byteLength: offset }];
  for (const name of ["extensionsUsed", "extensionsRequired"]) {
    tree[name] = tree[name]?.filter((one) => one !== NAME);
    if (!tree[name]?.length) delete tree[name];
  }
  const text = Buffer.from(JSON.stringify(tree));
  const padded = Buffer.concat([text, Buffer.alloc(-text.length & 3, " ")]);
  const head = Buffer.alloc(20);
  [0x46546c67, 2, 28 + padded.length + offset, padded.length, 0x4e4f534a].forEach((word, i) => head.writeUInt32LE(word, 4 * i));
  const chunk = Buffer.alloc(8);
  [offset, 0x004e4942].forEach((word, i) => chunk.writeUInt32LE(word, 4 * i));
  return Buffer.concat([head, padded, chunk, ...pieces]);
}

for (const name of readdirSync(folder)) writeFileSync(join(folder, name), unpacked(readFileSync(join(folder, name))));
process.stdout.write("{}");
