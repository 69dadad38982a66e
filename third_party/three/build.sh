#!/bin/sh
# Write opencv_tools/robot/view/page/three.js from the pinned packages of npm.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$here/entry.js" "$here/package.json" "$here/package-lock.json" "$work"
cd "$work"
npm ci --no-audit --no-fund
node_modules/.bin/esbuild entry.js --bundle --minify --format=iife --global-name=THREE \
    --target=es2022 --legal-comments=inline --log-level=warning \
    --banner:js='/*! three.js 0.187.0, https://threejs.org, MIT License, Copyright 2010-2026 three.js authors */' \
    --outfile="$here/../../opencv_tools/robot/view/page/three.js"
cp node_modules/three/LICENSE "$here/LICENSE"
cp node_modules/three/LICENSE "$here/../../opencv_tools/robot/view/page/three_license.txt"
cd "$here/../../opencv_tools/robot/view/page"
sha256sum three.js three_license.txt > "$here/SHA256SUMS"
