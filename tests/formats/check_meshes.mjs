// Checks the .glb and .drc files of a folder: every .glb by the Khronos validator, and every Draco
// payload by the decoder that browsers use. Prints one line per file; exit code 1 if one is wrong.
import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import draco3d from 'draco3dgltf';
import validator from 'gltf-validator';

const folder = process.argv[2];
const draco = await draco3d.createDecoderModule();
let faults = 0;

function fault(name, text) {
  faults += 1;
  console.log(`${name}: WRONG: ${text}`);
}

/** Vertices, triangles and bounds of a Draco buffer. */
function decode(bytes, ids) {
  const decoder = new draco.Decoder();
  const mesh = new draco.Mesh();
  const status = decoder.DecodeArrayToMesh(bytes, bytes.length, mesh);
  if (!status.ok()) throw new Error(status.error_msg());
  const sizes = {};
  for (const [name, id] of Object.entries(ids)) {
    const attribute = decoder.GetAttributeByUniqueId(mesh, id);
    if (attribute.ptr === 0) throw new Error(`no attribute ${id} for ${name}`);
    const values = new draco.DracoFloat32Array();
    decoder.GetAttributeFloatForAllPoints(mesh, attribute, values);
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < values.size(); ++i) {
      low[i % 3] = Math.min(low[i % 3], values.GetValue(i));
      high[i % 3] = Math.max(high[i % 3], values.GetValue(i));
    }
    sizes[name] = { count: values.size() / 3, low, high };
  }
  return { points: mesh.num_points(), faces: mesh.num_faces(), sizes };
}

function checkDracoPrimitive(name, bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const jsonSize = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + jsonSize)));
  const primitive = json.meshes?.[0].primitives[0];
  const extension = primitive?.extensions?.KHR_draco_mesh_compression;
  if (!extension) return 'no Draco';
  const { byteOffset, byteLength } = json.bufferViews[extension.bufferView];
  const start = 20 + jsonSize + 8 + byteOffset;
  const mesh = decode(bytes.subarray(start, start + byteLength), extension.attributes);
  if (json.accessors[primitive.indices].count !== mesh.faces * 3) fault(name, 'count of indices');
  for (const [attribute, index] of Object.entries(primitive.attributes)) {
    const accessor = json.accessors[index];
    const found = mesh.sizes[attribute];
    if (!found) fault(name, `${attribute} is not in the Draco payload`);
    else if (found.count !== accessor.count) fault(name, `count of ${attribute}`);
    else if (accessor.min && JSON.stringify(accessor.min) !== JSON.stringify(found.low)) {
      fault(name, `minimum of ${attribute}: ${accessor.min}, decoded ${found.low}`);
    } else if (accessor.max && JSON.stringify(accessor.max) !== JSON.stringify(found.high)) {
      fault(name, `maximum of ${attribute}: ${accessor.max}, decoded ${found.high}`);
    }
  }
  return `Draco: ${mesh.points} vertices, ${mesh.faces} triangles`;
}

const names = readdirSync(folder).filter((name) => /\.(glb|drc)$/.test(name)).sort();
for (const name of names) {
  const bytes = new Uint8Array(readFileSync(join(folder, name)));
  try {
    if (name.endsWith('.drc')) {
      const mesh = decode(bytes, { POSITION: 0 });
      console.log(`${name}: Draco: ${mesh.points} vertices, ${mesh.faces} triangles`);
      continue;
    }
    const report = await validator.validateBytes(bytes, { maxIssues: 50 });
    const { numErrors, numWarnings } = report.issues;
    for (const issue of report.issues.messages.filter((m) => m.severity <= 1)) {
      fault(name, `${issue.code} at ${issue.pointer}: ${issue.message}`);
    }
    console.log(`${name}: ${numErrors} errors, ${numWarnings} warnings; ${checkDracoPrimitive(name, bytes)}`);
  } catch (error) {
    fault(name, String(error));
  }
}
if (names.length === 0) fault(folder, 'no .glb or .drc file');
process.exit(faults === 0 ? 0 : 1);
