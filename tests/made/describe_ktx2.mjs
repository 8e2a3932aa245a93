// Prints the header of each KTX2 file of a folder and the mean colour of its levels:
// node describe_ktx2.mjs NODE_MODULES FOLDER
import { readdirSync, readFileSync, writeSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [, , modules, folder] = process.argv;
const { read } = await import(pathToFileURL(join(modules, "ktx-parse/dist/ktx-parse.modern.js")));
const { NodeBasisEncoder } = await import(pathToFileURL(join(modules, "ktx2-encoder/dist/node/index.js")));
// The transcoder prints its version.
console.log = () => {};
const basis = await new NodeBasisEncoder().init();
const RGBA32 = 13;

function meanOfLevel(file, level) {
  const pixels = new Uint8Array(file.getImageTranscodedSizeInBytes(level, 0, 0, RGBA32));
  file.transcodeImage(pixels, level, 0, 0, RGBA32, 0, -1, -1);
  const sums = [0, 0, 0, 0];
  pixels.forEach((value, i) => (sums[i % 4] += value));
  return sums.map((sum) => (4 * sum) / pixels.length);
}

const said = {};
for (const name of readdirSync(folder)) {
  const data = new Uint8Array(readFileSync(join(folder, name)));
  const header = read(data);
  const [{ colorModel, transferFunction, colorPrimaries }] = header.dataFormatDescriptor;
  const file = new basis.KTX2File(data);
  file.startTranscoding();
  said[name] = {
    size: [header.pixelWidth, header.pixelHeight],
    scheme: header.supercompressionScheme,
    layout: [header.pixelDepth, header.layerCount, header.faceCount],
    colorModel, transferFunction, colorPrimaries,
    hasAlpha: Boolean(file.getHasAlpha()),
    means: header.levels.map((_, level) => meanOfLevel(file, level)),
  };
}
writeSync(1, JSON.stringify(said));
