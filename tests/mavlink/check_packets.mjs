// check_packets.mjs read PACKETS JSON: node-mavlink decodes the packets, and every field, the envelope
//   and the bytes that it makes of them itself are compared with what the JSON says.
// check_packets.mjs write PACKETS PACKETS_V1: writes packets with all kinds of values, as MAVLink 2 and
//   1 (the latter without the fields that it does not have).
import { createReadStream, readFileSync, writeFileSync } from 'node:fs';
import nodeMavlink from 'node-mavlink';

const { common, minimal, createMavLinkStream, MavLinkProtocolV1, MavLinkProtocolV2 } = nodeMavlink;
const REGISTRY = { ...minimal.REGISTRY, ...common.REGISTRY };
const [mode, packetsPath, otherPath] = process.argv.slice(2);

/** Whether a decoded value is the one that was written: 64-bit numbers are strings, NaN is null. */
function same(decoded, said) {
  if (Array.isArray(said)) {
    return decoded.length === said.length && said.every((value, i) => same(decoded[i], value));
  }
  if (typeof decoded === 'bigint') return decoded.toString() === said;
  if (said === null) return Number.isNaN(decoded);
  return decoded === said;
}

async function read() {
  const said = JSON.parse(readFileSync(otherPath, 'utf8'));
  let at = 0;
  let faults = 0;
  const fault = (text) => {
    faults += 1;
    console.log(`packet ${at}: WRONG: ${text}`);
  };
  let fields = 0;
  for await (const packet of createMavLinkStream(createReadStream(packetsPath))) {
    const expected = said[at] ?? { fields: {} };
    const { header } = packet;
    const envelope = { id: header.msgid, sequence: header.seq, system: header.sysid, component: header.compid };
    for (const [key, value] of Object.entries(envelope)) {
      if (value !== expected[key]) fault(`${key} is ${value}, not ${expected[key]}`);
    }
    const type = REGISTRY[header.msgid];
    const message = packet.protocol.data(packet.payload, type);
    if (Object.keys(expected.fields).length !== type.FIELDS.length) fault('number of fields');
    for (const field of type.FIELDS) {
      fields += 1;
      const value = message[field.name];
      if (!same(value, expected.fields[field.source])) {
        fault(`${type.MSG_NAME}.${field.source} is ${value}, not ${expected.fields[field.source]}`);
      }
    }
    const again = new MavLinkProtocolV2(header.sysid, header.compid).serialize(message, header.seq);
    if (!again.equals(packet.buffer)) fault(`its bytes are ${again.toString('hex')} from there`);
    at += 1;
  }
  if (at !== said.length) fault(`${at} packets, not ${said.length}`);
  if (faults > 0) process.exit(1);
  console.log(`${at} packets, ${fields} fields, bytes: all right`);
}

/** Numbers that repeat (xorshift). */
let state = 88675123;
function random() {
  state ^= state << 13;
  state ^= state >>> 17;
  state ^= state << 5;
  return (state >>> 0) / 2 ** 32;
}

function value(type, length) {
  const element = type.replace('[]', '');
  if (type === 'char[]') {
    return 'lost: the wall is blank, and so is this text, by far'.slice(0, Math.floor(random() * (length + 1)));
  }
  if (length > 0) return Array.from({ length }, () => value(element, 0));
  if (element === 'float') return random() < 0.1 ? NaN : Math.fround((random() - 0.5) * 1e4);
  if (element === 'uint8_t_mavlink_version') return 3;
  const [, unsigned, bits] = /^(u?)int(\d+)_t$/.exec(element);
  const span = 2 ** (random() < 0.3 ? 3 : Number(bits));  // small values as well: zeros get cut
  const number = BigInt(Math.floor(random() * span));
  const signed = unsigned ? number : BigInt.asIntN(Number(bits), number);
  return bits === '64' ? signed : Number(signed);
}

function write() {
  const v2 = [];
  const v1 = [];
  for (let sequence = 0; sequence < 400; sequence += 1) {
    const types = [0, 24, 111, 253, 331].map((id) => REGISTRY[id]);
    const type = types[sequence % types.length];
    const message = new type();
    // Without extensions, both versions say the same. MAVLink 1 has no ids above 255.
    const plain = type.MSG_ID < 256 && random() < 0.5;
    for (const field of type.FIELDS) {
      const zero = field.type.includes('64') ? 0n : 0;
      message[field.name] = field.extension && plain ? zero : value(field.type, field.length);
    }
    const system = 1 + (sequence % 250);
    const bytes = new MavLinkProtocolV2(system, 197).serialize(message, sequence % 256);
    v2.push(bytes);
    v1.push(plain ? new MavLinkProtocolV1(system, 197).serialize(message, sequence % 256) : bytes);
  }
  writeFileSync(packetsPath, Buffer.concat(v2));
  writeFileSync(otherPath, Buffer.concat(v1));
}

await (mode === 'read' ? read() : write());
