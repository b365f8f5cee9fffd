// SPDX-License-Identifier: Apache-2.0
// Reads and writes recordings by @mcap/core.
//
//     node judge.mjs stream FILE...   what is in them, read from the front; also of files that are cut off
//     node judge.mjs index FILE...    the same, by their index
//     node judge.mjs write DIRECTORY  makes files of each kind that @mcap/core can write
//
// tests/mcap/recording.cpp prints the same words for the same file.

import { open, readFile, writeFile } from 'node:fs/promises';
import { McapIndexedReader, McapStreamReader, McapWriter } from '@mcap/core';
import { loadDecompressHandlers } from '@mcap/support';
import * as zstd from '@foxglove/wasm-zstd';

const hex = (bytes) => Buffer.from(bytes).toString('hex');
const pairs = (map) => [...map].sort(([a], [b]) => (a < b ? -1 : 1)).map(([k, v]) => ` ${k}=${v}`).join('');
const byId = (map) => [...map.values()].sort((a, b) => a.id - b.id);

const say = {
  header: (h) => `header ${h.profile}`,
  schema: (s) => `schema ${s.id} ${s.name} ${s.encoding} ${hex(s.data)}`,
  channel: (c) => `channel ${c.id} ${c.schemaId} ${c.topic} ${c.messageEncoding}${pairs(c.metadata)}`,
  message: (m) => `message ${m.channelId} ${m.sequence} ${m.logTime} ${m.publishTime} ${hex(m.data)}`,
  attachment: (a) => `attachment ${a.name} ${a.mediaType} ${a.logTime} ${a.createTime} ${hex(a.data)}`,
  metadata: (m) => `metadata ${m.name}${pairs(m.metadata)}`,
  statistics: (s) =>
    `statistics ${s.messageCount} ${s.schemaCount} ${s.channelCount} ${s.attachmentCount} ${s.metadataCount} ` +
    `${s.chunkCount} ${s.messageStartTime} ${s.messageEndTime}` +
    [...s.channelMessageCounts].sort(([a], [b]) => a - b).map(([c, n]) => ` ${c}:${n}`).join(''),
};

function print(header, schemas, channels, lines) {
  const known = [...byId(schemas).map(say.schema), ...byId(channels).map(say.channel)];
  console.log([say.header(header), ...known, ...lines].join('\n'));
}

async function stream(path) {
  const reader = new McapStreamReader({ decompressHandlers: await loadDecompressHandlers(), validateCrcs: true });
  reader.append(await readFile(path));
  const schemas = new Map();
  const channels = new Map();
  const messages = [];
  const others = [];
  let header = { profile: '' };
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === 'Header') header = record;
    if (record.type === 'Schema') schemas.set(record.id, record);
    if (record.type === 'Channel') channels.set(record.id, record);
    if (record.type === 'Message') messages.push(say.message(record));
    if (record.type === 'Attachment') others.push(say.attachment(record));
    if (record.type === 'Metadata') others.push(say.metadata(record));
  }
  print(header, schemas, channels, [...messages, ...others.sort(), `end ${reader.done()}`]);
}

async function index(path) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      await file.read(bytes, 0, bytes.length, Number(offset));
      return bytes;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
  const lines = [];
  for await (const message of reader.readMessages({ validateCrcs: true })) lines.push(say.message(message));
  const others = [];
  for await (const attachment of reader.readAttachments({ validateCrcs: true })) others.push(say.attachment(attachment));
  for await (const metadata of reader.readMetadata()) others.push(say.metadata(metadata));
  const topic = byId(reader.channelsById)[0]?.topic;
  let some = 0;
  for await (const message of reader.readMessages({ topics: [topic], startTime: 1010n, endTime: 1050n })) {
    some += message.channelId;
  }
  lines.push(...others.sort(), say.statistics(reader.statistics), `some ${some}`);
  print(reader.header, reader.schemasById, reader.channelsById, lines);
  await file.close();
}

/** A frame of lz4 whose blocks are stored as they are: @foxglove/wasm-lz4 only uncompresses. */
function lz4(bytes) {
  const parts = [Buffer.from('04224d18604082', 'hex')];
  for (let at = 0; at < bytes.length; at += 65536) {
    const block = bytes.subarray(at, at + 65536);
    const size = Buffer.alloc(4);
    size.writeUInt32LE((block.length | 0x80000000) >>> 0);
    parts.push(size, Buffer.from(block));
  }
  return new Uint8Array(Buffer.concat([...parts, Buffer.alloc(4)]));
}

class Memory {
  parts = [];
  length = 0n;
  async write(bytes) {
    this.parts.push(Buffer.from(bytes));
    this.length += BigInt(bytes.length);
  }
  position() {
    return this.length;
  }
}

async function writeOne(path, options) {
  const memory = new Memory();
  const writer = new McapWriter({ writable: memory, chunkSize: 500, ...options });
  await writer.start({ profile: 'judge', library: 'judge' });
  const channels = [];
  for (const topic of ['/a', '/b', '/c']) {
    const schemaId = await writer.registerSchema({
      name: `type${topic}`, encoding: 'jsonschema', data: new TextEncoder().encode('{}'),
    });
    channels.push(await writer.registerChannel({
      schemaId: topic === '/c' ? 0 : schemaId, topic, messageEncoding: 'json', metadata: new Map([['z', '1'], ['a', topic]]),
    }));
  }
  for (let i = 0; i < 100; ++i) {
    const data = new Uint8Array(i % 10 === 3 ? 2000 : i % 7).fill(i);
    const logTime = 1000n + BigInt(i) - BigInt((i * 37) % 11);
    await writer.addMessage({ channelId: channels[i % 3], sequence: i, logTime, publishTime: BigInt(i), data });
    if (i === 50) {
      await writer.addAttachment({
        name: 'notes', mediaType: 'text/plain', logTime: 7n, createTime: 8n, data: new Uint8Array([1, 2, 3]),
      });
      await writer.addMetadata({ name: 'machine', metadata: new Map([['host', 'x']]) });
    }
  }
  await writer.end();
  await writeFile(path, Buffer.concat(memory.parts));
}

async function write(directory) {
  await zstd.isLoaded;
  const plain = { repeatSchemas: false, repeatChannels: false, useStatistics: false, useSummaryOffsets: false };
  const kinds = {
    none: {},
    zstd: { compressChunk: (d) => ({ compression: 'zstd', compressedData: new Uint8Array(zstd.compress(d, 3)) }) },
    lz4: { compressChunk: (d) => ({ compression: 'lz4', compressedData: lz4(d) }) },
    unchunked: { useChunks: false },
    unindexed: { useMessageIndex: false, useChunkIndex: false, useAttachmentIndex: false, useMetadataIndex: false },
    bare: { ...plain, useChunks: false, useAttachmentIndex: false, useMetadataIndex: false },
    no_repeats: plain,
  };
  for (const [kind, options] of Object.entries(kinds)) await writeOne(`${directory}/${kind}.mcap`, options);
}

const [, , verb, ...paths] = process.argv;
for (const path of paths) {
  await { stream, index, write }[verb](path);
  console.log(`-- ${path}`);
}
