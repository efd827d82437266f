# bash completion for penumbra
_penumbra() {
  local current=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD - 1]}
  local command='' options='--help --version --log-level' words='' i
  for ((i = 1; i < COMP_CWORD; i++)); do
    case ${COMP_WORDS[i]} in
      -*) ;;
      *) command=${COMP_WORDS[i]}; break ;;
    esac
  done
  case $command in
    demo) options='--help --version --log-level --output --object --shadow --kernels --light-mode --proxy --translucency --layers --show-rays --hide-walls --no-window' ;;
    replay) options='--help --version --log-level --scene --object --tags --calibration --camera-name --shadow --kernels --light-mode --proxy --translucency --layers --show-rays --hide-walls --compare --tracking --pose-budget --no-background-search --refine-map --refine-camera --smooth --poses-from --output --poses --poses-all --group-poses --frame-log --report --save-scene --frames --realtime --no-edits --threads --rectified --msaa --pixel-buffers --no-video-light --no-skip --max-gap --time-offset --no-window --no-hud --fullscreen' ;;
    live) options='--help --version --log-level --camera --calibration --camera-name --size --scale-calibration --fov --fps --format --exposure --gain --white-balance --focus --no-dma-buf --record --duration --scene --object --tags --shadow --kernels --light-mode --proxy --translucency --layers --show-rays --hide-walls --tracking --pose-budget --no-background-search --refine-map --refine-camera --smooth --output --poses --poses-all --group-poses --frame-log --report --save-scene --threads --rectified --msaa --pixel-buffers --no-video-light --no-skip --no-window --no-hud --fullscreen --no-vsync --kiosk --reset-after --config' ;;
    setup) options='--help --version --log-level --camera --page --measured --size --fps --no-window --config' ;;
    devices) options='--help --version --log-level' ;;
    evaluate) options='--help --version --log-level --estimated --groundtruth --split-half --camera --camera-name --tags --json --plot --per-frame --estimated-groups --groundtruth-groups --tracking --pose-budget --no-background-search --max-gap --time-offset' ;;
    shadow) options='--help --version --log-level --light-height --light-ratio --umbra-height --workspace-height --magnification --kernels --light-mode --group --pose --plane --technique --light --proxy --up --unit --animation --time --show-kernels --output' ;;
    target) options='--help --version --log-level --output --tags --page --family --dictionary --type --first-id --columns --rows --tag-size --pitch --spacing --square --measured' ;;
    calibrate) options='--help --version --log-level --target --output --report --model --board --format --compare --camera-name --focus-position --views --keep --no-window --size --fps --duration' ;;
    map) options='--help --version --log-level --tag-size --sizes --anchor --family --camera --camera-name --plane --refine-camera --output' ;;
    kernels) options='--help --version --log-level --up --unit --animation --time --kernels --group --output' ;;
    import) options='--help --version --log-level --output --calibration --camera-name --tags --frames' ;;
    simulate) options='--help --version --log-level --camera --camera-name --tags --trajectory --group --output --noise --blur --seed --tone --gain --lens-blur --cover --cover-from' ;;
    study) options='--help --version --log-level --experiment --output --techniques --participant --seed --trials --tolerance --pause --resume --recording --poses-from --camera --calibration --camera-name --fps --tags --tracking --pose-budget --no-background-search --script --plan --no-window' ;;
  esac
  case "$command $previous" in
    'demo --shadow') words='none simple cocl layered field walls hard volume' ;;
    'demo --light-mode') words='proportional fixed' ;;
    'demo --proxy') words='auto none' ;;
    'demo --translucency') words='auto blend mesh retexture geometry-mesh' ;;
    'demo --layers') words='auto direct mask' ;;
    'replay --shadow') words='none simple cocl layered field walls hard volume' ;;
    'replay --light-mode') words='proportional fixed' ;;
    'replay --proxy') words='auto none' ;;
    'replay --translucency') words='auto blend mesh retexture geometry-mesh' ;;
    'replay --layers') words='auto direct mask' ;;
    'replay --pixel-buffers') words='auto on off' ;;
    'live --shadow') words='none simple cocl layered field walls hard volume' ;;
    'live --light-mode') words='proportional fixed' ;;
    'live --proxy') words='auto none' ;;
    'live --translucency') words='auto blend mesh retexture geometry-mesh' ;;
    'live --layers') words='auto direct mask' ;;
    'live --pixel-buffers') words='auto on off' ;;
    'shadow --light-mode') words='proportional fixed' ;;
    'shadow --up') words='y z' ;;
    'shadow --unit') words='mm cm m in' ;;
    'calibrate --format') words='auto ros opencv kalibr' ;;
    'map --plane') words='fitted anchor' ;;
    'kernels --unit') words='mm cm m in' ;;
    'study --experiment') words='heights drag' ;;
  esac
  if [[ -n $words ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$words" -- "$current")
  elif [[ $current == -* ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$options" -- "$current")
  elif [[ -z $command ]]; then
    mapfile -t COMPREPLY < <(compgen -W 'demo replay live setup devices evaluate shadow target calibrate map kernels import simulate study' -- "$current")
  fi
}
complete -o default -F _penumbra penumbra
