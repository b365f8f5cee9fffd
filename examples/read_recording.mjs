// SPDX-License-Identifier: Apache-2.0
// Reads a recording of LOT without LOT: by @mcap/core, the messages by the schemas in the file.
//
//     scripts/setup test                       installs the packages of npm into build/judges
//     node examples/read_recording.mjs FILE    says what each topic has, and its first message
//
// In a project of your own: copy this file, and install the packages beside it.
//     npm install @mcap/core @mcap/support @foxglove/rosmsg @foxglove/rosmsg2-serialization

import { open } from 'node:fs/promises';
import { createRequire } from 'node:module';

if (process.argv.length !== 3) {
  console.error('usage: node read_recording.mjs FILE');
  process.exit(2);
}

/** A package beside this file, or one that scripts/setup has installed. */
const load = (name) => {
  try {
    return createRequire(import.meta.url)(name);
  } catch (error) {
    if (error.code !== 'MODULE_NOT_FOUND') throw error;
    return createRequire(new URL('../build/judges/', import.meta.url))(name);
  }
};
const { McapIndexedReader } = load('@mcap/core');
const { loadDecompressHandlers } = load('@mcap/support');
const { parse } = load('@foxglove/rosmsg');
const { MessageReader } = load('@foxglove/rosmsg2-serialization');

/** A long array is told by its kind and length. */
const shortened = (_, value) =>
  ArrayBuffer.isView(value) ? `${value.constructor.name}(${value.length})` : typeof value === 'bigint' ? `${value}` : value;

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => {
    const bytes = new Uint8Array(Number(size));
    await file.read(bytes, 0, bytes.length, Number(offset));
    return bytes;
  },
};
const recording = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });

const topics = new Map();
for await (const message of recording.readMessages({ validateCrcs: true })) {
  const { topic, schemaId } = recording.channelsById.get(message.channelId);
  if (!topics.has(topic)) {
    const schema = recording.schemasById.get(schemaId);
    const reader = new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true }));
    topics.set(topic, { type: schema.name, count: 0, reader, first: reader.readMessage(message.data) });
  }
  const its = topics.get(topic);
  its.reader.readMessage(message.data); // each one can be decoded
  ++its.count;
}
for (const [topic, { type, count, first }] of [...topics].sort()) {
  console.log(`${topic}  ${type}  ${count} messages, the first: ${JSON.stringify(first, shortened)}`);
}
for await (const { name, metadata } of recording.readMetadata()) {
  if (name === 'lot.topic') console.log(`${metadata.get('topic')}: ${metadata.get('missed')} missed, ${metadata.get('lost')} lost`);
}
await file.close();
